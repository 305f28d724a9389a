"""``cazsl predict``: predict one push or a file of pushes, without a service."""

import base64
import json
from pathlib import Path
from typing import Any, Final

import click

from service.api.v1.queries import ask_model
from service.cli.command_line import FILE, FILE_THAT_EXISTS, argument, errors_as_one_line, option, registry_option
from service.cli.models import load_reference
from service.cli.predict_parquet import default_model, predict_parquet
from service.cli.terminal import print_json
from service.errors import DataError
from service.files import read_file, without_mark
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind
from service.registry.location import open_registry
from service.schemas.body import validate_body
from service.schemas.documents import parse_json
from service.schemas.pushes import PredictRequest

POSE_PARTS: Final = 3
MAX_IMAGE_BYTES: Final = 8 << 20  # as large as a decoder accepts


@click.command()
@argument("push", nargs=-1, metavar="[DESCRIPTOR] X_M Y_M ANGLE_RAD")
@option(
    "--parquet",
    "files",
    nargs=2,
    type=FILE,
    metavar="IN OUT",
    help="Predict every row of the Parquet file IN into the new file OUT.",
)
@option(
    "--jobs",
    type=click.IntRange(1),
    help="With --parquet: number of threads. [default: one per processor]",
)
@option(
    "--ray", "ray_address", metavar="ADDRESS", help="With --parquet: the Ray cluster that predicts, HOST:PORT or auto."
)
@option("--model", "reference", help="NAME, NAME@ALIAS or NAME@VERSION. [default: the champion for this context]")
@option("--length", "length_m", type=float, help="Length of the push, in m. [default: 0.05]")
@option("--context", "context_file", type=FILE_THAT_EXISTS, help="JSON file of a context, as in POST /v1/predict.")
@option("--image", "image_file", type=FILE_THAT_EXISTS, help="Image of the object from above: PNG, JPEG or WebP.")
@option("--metres-per-pixel", type=float, help="Scale of the image. Its object is then one of any shape.")
@option("--centre-of-mass", nargs=2, type=float, metavar="X_M Y_M", help="Centre of mass of a shape, in its frame.")
@option("--friction", type=float, help="Coefficient of friction of pusher and shape.")
@option("--pusher-radius", type=float, help="Radius of the round tip that pushes a shape, in m.")
@option("--pressure", nargs=3, type=float, metavar="XX XY YY", help="Spread of a shape's weight, see docs/planning.md.")
@registry_option
@errors_as_one_line
def predict(
    push: tuple[str, ...],
    files: tuple[Path, Path] | None,
    jobs: int | None,
    ray_address: str | None,
    reference: str | None,
    length_m: float | None,
    registry: str,
    **described: Any,
) -> None:
    """Predict one push, or a Parquet file of pushes, without a service.

    \b
    cazsl predict 1a2b3c4a -- -0.075 0 0
    cazsl predict --context box.json --length 0.02 -- -0.1 0 0
    cazsl predict --context pushed.json -- -0.075 0 0
    cazsl predict --image wrench.png --metres-per-pixel 0.0004 -- -0.1 0 0
    cazsl predict --parquet pushes.parquet predictions.parquet

    One push prints the answer of POST /v1/predict. DESCRIPTOR is the object's four sides, each a shape digit and a
    weight letter, such as 1a2b3c4a. box.json is {"outline": [[0.06, 0.04], [-0.06, 0.04], [-0.06, -0.04], [0.06,
    -0.04]]}, in m, and pushed.json {"support": {"pushers": [[-0.075, 0, 0]], "outcomes": [[0.02, 0, 0]]}}, pushes of
    the object that were observed. Without an object, a model without context predicts. The pusher's pose is in the
    object's frame. Put -- before it if a number is negative.

    A file (extra 'parquet') has the columns x_m, y_m and angle_rad, and one column for the object: descriptor (text),
    visual (1,024 bytes), context (JSON of a shape, such as box.json), support (JSON of a support, the object inside of
    pushed.json), or none. With context, length_m may be a column. Other columns are kept. OUT has the same rows in the
    same order, with mean_x_m, mean_y_m, mean_angle_rad, std_x_m, std_y_m, std_angle_rad, and warnings, the codes of
    POST /v1/predict with spaces between them. Its metadata name model and version. It appears once it is complete, is
    the same to the bit for any number of jobs, and never replaces another file.
    """
    given = {name: value for name, value in described.items() if value is not None}
    if files is not None:
        if push or given or length_m is not None or (jobs is not None and ray_address is not None):
            raise click.UsageError("--parquet reads pushes and objects from IN alone, and takes either --jobs or --ray")
        predict_parquet(*files, reference, open_registry(registry), jobs, ray_address)
        return
    if jobs is not None or ray_address is not None:
        raise click.UsageError("--jobs and --ray need --parquet IN OUT")
    if len(push) not in (POSE_PARTS, POSE_PARTS + 1):
        raise click.UsageError(
            f"received {len(push)} arguments; accepted is [DESCRIPTOR] X_M Y_M ANGLE_RAD, or --parquet IN OUT"
        )
    if len(push) > POSE_PARTS:
        given["descriptor"] = push[0]
    x_m, y_m, angle_rad = (click.FLOAT(word) for word in push[-POSE_PARTS:])
    document: dict[str, Any] = {"pusher": {"x": x_m, "y": y_m, "angle": angle_rad}}
    if length_m is not None:
        document["pusher"]["length"] = length_m
    if given:
        document["context"] = _context(given)
    request = validate_body(PredictRequest, document)
    store = open_registry(registry)

    def find(kind: ContextKind) -> LoadedModel:
        """Return the model that answers for a kind of context."""
        return load_reference(store, reference or default_model(kind))

    print_json(json.loads(ask_model(find, request).answer().content))


def _context(given: dict[str, Any]) -> dict[str, Any]:
    """Return the document of a context: the fields of a file of JSON, an image, and those that options gave.

    Raises:
        DataError: a file cannot be read.
        RequestError: the file of JSON is none.
    """
    found: dict[str, Any] = {name: list(value) if isinstance(value, tuple) else value for name, value in given.items()}
    context_file: Path | None = found.pop("context_file", None)
    image_file: Path | None = found.pop("image_file", None)
    try:
        if image_file is not None:
            found["image"] = base64.b64encode(read_file(image_file, MAX_IMAGE_BYTES)).decode()
        if context_file is None:
            return found
        document = parse_json(without_mark(read_file(context_file)))
    except OSError as error:
        raise DataError(f"{error.filename}: cannot be read: {error.strerror}") from error
    if not isinstance(document, dict):
        raise DataError(f'{context_file}: received JSON that is no object; accepted is one as {{"outline": [...]}}')
    return {**document, **found}
