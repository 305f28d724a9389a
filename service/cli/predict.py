"""``cazsl predict``: predict one push or a file of pushes, without a service."""

import json
from pathlib import Path
from typing import Final

import click
import pydantic

from service.api.v1.queries import ask_model
from service.cli.command_line import FILE, argument, errors_as_one_line, option, registry_option
from service.cli.models import load_reference
from service.cli.predict_parquet import predict_parquet
from service.cli.terminal import print_json
from service.inference.snapshot import DEFAULT_MODELS
from service.model.tensors import ContextKind
from service.registry.location import open_registry
from service.schemas.contexts import ContextBody
from service.schemas.pushes import PredictRequest, PusherBody

POSE_PARTS: Final = 3


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
@registry_option
@errors_as_one_line
def predict(
    push: tuple[str, ...],
    files: tuple[Path, Path] | None,
    jobs: int | None,
    ray_address: str | None,
    reference: str | None,
    registry: str,
) -> None:
    """Predict one push, or a Parquet file of pushes, without a service.

    \b
    cazsl predict 1a2b3c4a -- -0.075 0 0
    cazsl predict --parquet pushes.parquet predictions.parquet

    One push prints the answer of POST /v1/predict. DESCRIPTOR is the object's four sides, each a shape digit and a
    weight letter, such as 1a2b3c4a. Without it, a model without context predicts. The pusher's pose is in the
    object's frame. Put -- before it if a number is negative.

    A file (extra 'parquet') has the columns x_m, y_m and angle_rad, and one column for the object: descriptor (text),
    visual (1,024 bytes), or none. Other columns are kept. OUT has the same rows in the same order, with mean_x_m,
    mean_y_m, mean_angle_rad, std_x_m, std_y_m and std_angle_rad. Its metadata name model and version. It appears once
    it is complete, is the same to the bit for any number of jobs, and never replaces another file.
    """
    if files is not None:
        if push or (jobs is not None and ray_address is not None):
            raise click.UsageError("--parquet reads pushes from IN alone, and takes either --jobs or --ray")
        predict_parquet(*files, reference, open_registry(registry), jobs, ray_address)
        return
    if jobs is not None or ray_address is not None:
        raise click.UsageError("--jobs and --ray need --parquet IN OUT")
    if len(push) not in (POSE_PARTS, POSE_PARTS + 1):
        raise click.UsageError(
            f"received {len(push)} arguments; accepted is [DESCRIPTOR] X_M Y_M ANGLE_RAD, or --parquet IN OUT"
        )
    descriptor = None if len(push) == POSE_PARTS else push[0]
    x_m, y_m, angle_rad = (click.FLOAT(word) for word in push[-POSE_PARTS:])
    context = None if descriptor is None else ContextBody(descriptor=descriptor)
    try:
        request = PredictRequest(pusher=PusherBody(x=x_m, y=y_m, angle=angle_rad), context=context, model=reference)
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise click.ClickException(f"{first['loc'][-1]}: {first['msg']}") from error
    kind = ContextKind.NONE if context is None else ContextKind.INDICATOR
    answer = ask_model(load_reference(open_registry(registry), reference or DEFAULT_MODELS[kind]), request).answer()
    print_json(json.loads(answer.content))
