"""Any object: the first questions of a new user, each with its answer and its warnings, as a page with pictures.

    python -m benchmarks.any_object [--url http://localhost:8000] [--out docs/results/any-object]

Asked are a box of 120 x 80 mm and an L by their outlines, a mug by its mask, and a wrench on a wooden table by a
photograph, pushed by 10, 50 and 100 mm. A push misses, one starts inside and one has its angle in degrees. The last
picture is of an empty table. Without --url the models of --models-folder answer in this process.

The page has a picture of each object: its outline before and after the push, the ellipse and the fan of yaws that hold
90 %, and the pusher's path. Beside it stand the answers as JSON.
"""

import argparse
import base64
import io
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

import service
from benchmarks.any_object_pictures import Backdrop, Panel, draw_panels, in_words
from benchmarks.photographs import empty_table
from benchmarks.real_pushes import make_folder
from service.client import Client, ClientError, ContextBody, ProblemError
from service.errors import CazslError
from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import PUSHER_RADIUS_M
from service.storage.disk import replace_whole

PAGE_FILE, FIGURES_FILE = "README.md", "figures.json"
IMAGES: Final = Path("docs/images")
LENGTHS_M: Final = (0.010, 0.050, 0.100)
GAP_M: Final = 0.003  # between tip and object at the start of a push that is aimed here
OFFSET: Final = 0.4  # of such a push's line from the centroid, in sizes of the object
FAR: Final = 3.0  # in extents of the object
EMPTY_SEED: Final = 1
BOX: Final = ((0.06, 0.04), (-0.06, 0.04), (-0.06, -0.04), (0.06, -0.04))
L: Final = ((0.08, -0.03), (0.08, 0.0), (0.0, 0.0), (0.0, 0.07), (-0.03, 0.07), (-0.03, -0.03))
PAGE: Final = """# Any object

`{command}` asks the service as a new user would. `{model}` answers (cazsl {code}).

Grey is the object before the push, blue after it, at the mean of the answer. Orange is the pusher: an empty circle at
its start, a full one at its end. The ellipse holds the frame's origin (+) with a probability of 90 %, and the fan the
yaw. All numbers below the panels are mean and standard deviation.

{scenes}
"""


@dataclass(frozen=True)
class Push:
    """Push to ask about."""

    title: str
    pusher: tuple[float, float, float]
    length_m: float


@dataclass(frozen=True)
class Scene:
    """Object as a user sends it, and pushes of it. Without pushes, some are aimed at its outline.

    Attributes:
        name: of its picture.
        title: of its section.
        corners: its outline, or none for a picture.
        image: content of a picture.
        metres_per_pixel: scale of the picture.
        pushes: of the object.
    """

    name: str
    title: str
    corners: tuple[tuple[float, float], ...] = ()
    image: bytes = b""
    metres_per_pixel: float = 0.0
    pushes: tuple[Push, ...] = ()

    @property
    def context(self) -> ContextBody:
        """The context to send with a push."""
        if self.corners:
            return ContextBody(outline=[list(corner) for corner in self.corners])
        return ContextBody(image=base64.b64encode(self.image).decode(), metres_per_pixel=self.metres_per_pixel)


@dataclass(frozen=True)
class Answer:
    """Answer to one push, or the reason of its refusal. Lengths are in m, angles in rad."""

    push: Push
    model: str
    mean: tuple[float, float, float] | None
    std: tuple[float, float, float] | None
    warnings: tuple[str, ...]
    refusal: str


@dataclass(frozen=True, eq=False)
class Answered:
    """Scene with the outline that the service knows of it, and the answers to its pushes."""

    scene: Scene
    corners: DoubleArray | None
    answers: tuple[Answer, ...]


def scenes(images: Path = IMAGES) -> tuple[Scene, ...]:
    """Return the scenes of the page, with pictures from a folder."""
    box = (
        *(Push(f"{1e3 * length:.0f} mm", (-0.068, 0.02, 0.0), length) for length in LENGTHS_M),
        Push("misses", (-0.068, 0.055, 0.0), 0.05),
        Push("starts inside", (0.0, 0.02, 0.0), 0.05),
        Push("angle: 180", (0.068, 0.0, 180.0), 0.05),
    )
    angled = tuple(Push(f"{1e3 * length:.0f} mm", (0.008, 0.05, math.pi), length) for length in LENGTHS_M)
    blank = io.BytesIO()
    Image.fromarray(empty_table(np.random.default_rng(EMPTY_SEED)).levels).save(blank, "JPEG", quality=90)
    return (
        Scene("box", "A box of 120 x 80 mm, by its outline", BOX, pushes=box),
        Scene("l", "An L, by its outline", L, pushes=angled),
        Scene("mug", "A mug, by its mask", image=(images / "mug.png").read_bytes(), metres_per_pixel=0.0004),
        Scene("wrench", "A wrench, by a photograph", image=(images / "view.png").read_bytes(), metres_per_pixel=0.0004),
        Scene("empty", "An empty table", image=blank.getvalue(), metres_per_pixel=0.0004, pushes=(box[1],)),
    )


def aimed(corners: DoubleArray) -> tuple[Push, ...]:
    """Return pushes of three lengths onto the longer side, beside the centroid, that start near the outline."""
    outline = Outline.of(corners)
    width_m, height_m = np.ptp(corners, axis=0)
    angle = math.pi / 2.0 if width_m > height_m else 0.0
    ahead, aside = np.array([[math.cos(angle), math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    far = outline.centroid_m + OFFSET * outline.size_m * aside - FAR * outline.extent_m * ahead
    pusher = np.array([[*far, angle, np.inf]])
    travel_m = float(first_contact(outline, pusher, PUSHER_RADIUS_M).travel_m[0])
    x_m, y_m = np.round(far + (travel_m - GAP_M) * ahead, 3).tolist()
    return tuple(Push(f"{1e3 * length:.0f} mm", (x_m, y_m, angle), length) for length in LENGTHS_M)


def ask(client: Client, scene: Scene) -> Answered:
    """Find the outline of a scene's object, and ask for all of its pushes."""
    corners = np.array(scene.corners) if scene.corners else None
    if corners is None:
        try:
            found = client.find_outline(scene.image, metres_per_pixel=scene.metres_per_pixel)
            corners = np.array(found.context.outline)
        except ProblemError:
            corners = None  # a prediction is refused with the same words
    pushes = scene.pushes or (() if corners is None else aimed(corners))
    return Answered(scene, corners, tuple(_ask_one(client, scene.context, push) for push in pushes))


def _ask_one(client: Client, context: ContextBody, push: Push) -> Answer:
    try:
        found = client.predict(push.pusher, context, length=push.length_m)
    except ProblemError as error:
        return Answer(push, "", None, None, (), error.detail)
    mean, std = ((pose.x, pose.y, pose.angle) for pose in (found.mean, found.std))
    warnings = tuple(f"{one['code']}: {one['detail']}" for one in found.model_dump().get("warnings", []))
    return Answer(push, f"{found.model.name} {found.model.version}", mean, std, warnings, "")


def write_page(folder: Path, command: str, found: Sequence[Answered]) -> None:
    """Write the pictures, the page and the answers into a folder that exists."""
    for item in found:
        draw_panels(folder / f"{item.scene.name}.png", _panels(item), _backdrop(item.scene))
    answers = {item.scene.name: [asdict(answer) for answer in item.answers] for item in found}
    document = {"command": command, "code_version": service.__version__, "answers": answers}
    replace_whole(folder / FIGURES_FILE, (json.dumps(document, indent=1) + "\n").encode())
    models = {answer.model for item in found for answer in item.answers if answer.model}
    page = PAGE.format(
        command=command,
        model=", ".join(sorted(models)),
        code=service.__version__,
        scenes="\n\n".join(_section(item) for item in found),
    )
    replace_whole(folder / PAGE_FILE, page.encode())


def _section(found: Answered) -> str:
    """Return the section of a scene: the request of its first push, its picture, and warnings and refusals whole."""
    lines = [f"## {found.scene.title}", "", "```json", _request(found), "```", ""]
    lines += [f"![{found.scene.title}: each push]({found.scene.name}.png)", ""]
    for answer in found.answers:
        lines += [f"- {answer.push.title}: {text}" for text in answer.warnings]
        lines += [f"- {answer.push.title}: **refused**: {answer.refusal}" for _ in range(answer.mean is None)]
    return "\n".join(lines).rstrip()


def _request(found: Answered) -> str:
    """Return the body of the first request, without the bytes of a picture."""
    context = found.scene.context.model_dump(exclude_none=True)
    if found.scene.image:
        context["image"] = "<base64>"
    push = found.answers[0].push
    x, y, angle = push.pusher
    pusher = {"x": x, "y": y, "angle": round(angle, 4), "length": push.length_m}
    return f'{{"pusher": {json.dumps(pusher)},\n "context": {json.dumps(context)}}}'


def _panels(found: Answered) -> list[Panel]:
    panels = []
    for answer in found.answers:
        refused = answer.mean is None
        text = f"refused: {answer.refusal}" if refused else ", ".join(one.partition(":")[0] for one in answer.warnings)
        pusher = np.array([*answer.push.pusher, answer.push.length_m])
        mean, std = (None if pose is None else np.array(pose) for pose in (answer.mean, answer.std))
        panels.append(Panel(answer.push.title, found.corners, pusher, PUSHER_RADIUS_M, mean, std, text))
    return panels


def _backdrop(scene: Scene) -> Backdrop | None:
    if not scene.image:
        return None
    with Image.open(io.BytesIO(scene.image)) as picture:
        return Backdrop(np.asarray(picture.convert("RGBA")), scene.metres_per_pixel)


def main(arguments: Sequence[str] | None = None) -> None:
    """Ask, print the answers, and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.any_object",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--url", help="address of a service; by default the models answer in this process")
    parser.add_argument("--models-folder", type=Path, default=Path("models"), help="registry of published models")
    parser.add_argument("--images", type=Path, default=IMAGES, help="folder with mug.png and view.png (docs/images)")
    parser.add_argument("--out", type=Path, help="write page, pictures and answers into this folder")
    options = parser.parse_args(arguments)
    command = "python -m benchmarks.any_object" + (" --url URL" if options.url else "")
    try:
        make_folder(options.out)
        with Client(options.url) if options.url else Client.local(str(options.models_folder)) as client:
            found = [ask(client, scene) for scene in scenes(options.images)]
    except (CazslError, ClientError) as error:
        sys.exit(f"error: {error}")
    for item in found:
        print(item.scene.title)
        for answer in item.answers:
            print("  " + _line(answer))
    if options.out is None:
        print("\nnext: --out FOLDER writes this with pictures")
    else:
        write_page(options.out, command, found)
        print(f"\nwrote {options.out}; next: look at {options.out / PAGE_FILE}")


def _line(answer: Answer) -> str:
    if answer.mean is None or answer.std is None:
        return f"{answer.push.title}: refused: {answer.refusal}"
    figures = ", ".join(in_words(np.array(answer.mean), np.array(answer.std)))
    return f"{answer.push.title}: {figures} {' '.join(answer.warnings)}"


if __name__ == "__main__":
    main()
