"""Outlines found in pictures: overlap with the truth by condition, refusals of pictures without one object, and cost.

    python -m benchmarks.silhouettes [--count 1000] [--seed 31] [--jobs 2] [--out docs/results/silhouettes]

Photographs are rendered by ``benchmarks.photographs``: the families of outlines of the trainer on plain tables, wood,
cloth and stone. The seed is of photographs that nothing was chosen on. Chosen were the constants of
``service/silhouettes`` on seeds 11, 12 and 13. A success is an outline whose intersection over union with the true mask
is 0.9 or more. A failure is a wrong outline (a mistake), or a refusal of a picture that shows one object. Pictures of
two objects, of clipped ones and of empty tables, a fifth as many of each, shall be refused.

The cost is measured in processes of their own on the hardest pictures that the service accepts: processor time, and
memory above that of a process that has imported the same.
"""

import argparse
import json
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import Pool
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

import service
from benchmarks.photographs import Conditions, Photograph, clipped, empty_table, photograph, rendered_mask, two_objects
from benchmarks.real_pushes import make_folder
from benchmarks.silhouettes_cost import Cost, costs
from benchmarks.silhouettes_page import draw_examples, page
from service.errors import CazslError, InvalidRequestError
from service.pushing.images import ColourImage
from service.silhouettes.search import find_outline
from service.storage.disk import replace_whole

GOOD: Final = 0.9  # intersection over union of a success
SCALE: Final = 0.0005  # m per pixel
KINDS: Final[dict[str, Callable[[np.random.Generator], Photograph]]] = {
    "one object": photograph,
    "two objects": two_objects,
    "clipped": clipped,
    "empty table": empty_table,
}
ONE: Final = "one object"
PAGE_FILE, FIGURES_FILE, EXAMPLES_FILE = "README.md", "figures.json", "examples.jpg"
_CODE: Final = re.compile(r"\((image_\w+)\)")

Corners = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Result:
    """Result of the search in one picture.

    Attributes:
        kind: of picture, a key of ``KINDS``.
        number: of the picture among its kind.
        overlap: intersection over union with the true mask, 0 without an answer.
        refusal: code of a refusal, "" for an answer.
        cpu_s: processor time of the search.
        conditions: of the photograph, None for an empty table.
    """

    kind: str
    number: int
    overlap: float
    refusal: str
    cpu_s: float
    conditions: Conditions | None

    @property
    def good(self) -> bool:
        """Whether the outline is that of the object."""
        return self.overlap >= GOOD


def drawn(kind: str, number: int, seed: int) -> Photograph:
    """Draw a picture of a kind. The same seed and number give the same picture."""
    return KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind), number]))


def searched(levels: npt.NDArray[np.uint8]) -> tuple[Corners | None, str]:
    """Return the corners (n, 2) of the outline that is found, in pixels from the upper left, or the refusal's code."""
    try:
        found = find_outline(ColourImage.from_array(levels), SCALE)
    except InvalidRequestError as error:
        code = _CODE.search(str(error))
        return None, code.group(1) if code else "no single silhouette"
    return found.outline.corners / (SCALE, -SCALE) + np.array(levels.shape[1::-1]) / 2.0, ""


def overlap(corners: Corners | None, mask: npt.NDArray[np.bool_]) -> float:
    """Return the intersection over union of an outline in pixels with a mask, 0 without an outline."""
    if corners is None:
        return 0.0
    found = rendered_mask(corners, (mask.shape[1], mask.shape[0])) >= 0.5
    return float((found & mask).sum() / max(1, (found | mask).sum()))


def judged(picture: tuple[str, int], seed: int) -> Result:
    """Draw a picture, search it and judge the outline."""
    kind, number = picture
    shown = drawn(kind, number, seed)
    started = time.process_time()
    corners, refusal = searched(shown.levels)
    cpu_s = time.process_time() - started
    return Result(kind, number, overlap(corners, shown.mask), refusal, cpu_s, shown.conditions)


def mask_overlap(number: int, seed: int) -> float:
    """Return the overlap of the outline that is found in the mask of a photograph, white on black."""
    mask = drawn(ONE, number, seed).mask
    corners, _ = searched(mask.astype(np.uint8) * np.uint8(255))
    return overlap(corners, mask)


def summary(results: Sequence[Result], masks: Sequence[float]) -> dict[str, object]:
    """Return the figures of all results: shares in percent, times in seconds."""
    ones = [one for one in results if one.kind == ONE]
    wrong = [one for one in ones if not one.good]
    refused = Counter(one.refusal for one in wrong if one.refusal)
    others = {}
    for kind in list(KINDS)[1:]:
        codes = Counter(one.refusal or "answered" for one in results if one.kind == kind)
        total = max(1, codes.total())
        others[kind] = {"count": codes.total(), "refused": 100.0 * (1.0 - codes["answered"] / total), "codes": codes}
    count = max(1, len(ones))
    times = [one.cpu_s for one in results]
    return {
        "count": len(ones),
        "good": 100.0 * sum(one.good for one in ones) / count,
        "at_least_0.8": 100.0 * sum(one.overlap >= 0.8 for one in ones) / count,
        "median_overlap": float(np.median([one.overlap for one in ones])),
        "mistakes": 100.0 * sum(not one.refusal for one in wrong) / count,
        "grave_mistakes": 100.0 * sum(not one.refusal and one.overlap < 0.5 for one in wrong) / count,
        "false_refusals": {code: 100.0 * many / count for code, many in refused.most_common()},
        "others": others,
        "mask_least_overlap": min(masks),
        "cpu_s": {"mean": float(np.mean(times)), "p99": float(np.percentile(times, 99)), "max": max(times)},
    }


def examples(results: Sequence[Result], right: int, wrong: int) -> list[Result]:
    """Return the first results that are right, mistakes and false refusals, and refusals of the other kinds."""
    ones = [one for one in results if one.kind == ONE]
    chosen = [one for one in ones if one.good][:right]
    chosen += [one for one in ones if not one.good and not one.refusal][:wrong]
    chosen += [one for one in ones if not one.good and one.refusal][:wrong]
    for kind in list(KINDS)[1:]:
        chosen += [one for one in results if one.kind == kind][:2]
    return chosen


def write(folder: Path, command: str, seed: int, results: Sequence[Result], masks: Sequence[float]) -> None:
    """Measure the cost, and write page, figures and the picture of examples into a folder that exists."""
    found: list[Cost] = costs()
    figures = summary(results, masks)
    shown = [(one, drawn(one.kind, one.number, seed)) for one in examples(results, 12, 4)]
    draw_examples(
        folder / EXAMPLES_FILE,
        [
            (_title(one), picture.levels, picture.mask, None if one.refusal else searched(picture.levels)[0])
            for one, picture in shown
        ],
    )
    document = {"command": command, "code_version": service.__version__, "seed": seed, **figures}
    document["costs"] = [asdict(cost) for cost in found]
    document["failures"] = [asdict(one) for one in results if one.kind == ONE and not one.good]
    replace_whole(folder / FIGURES_FILE, (json.dumps(document, indent=1) + "\n").encode())
    conditions = [(one.conditions, one.good, one.refusal) for one in results if one.kind == ONE and one.conditions]
    replace_whole(folder / PAGE_FILE, page(command, seed, figures, conditions, found).encode())


def _title(one: Result) -> str:
    if one.kind != ONE:
        return f"{one.kind}: {one.refusal or 'answered'}"
    return one.refusal or f"{one.overlap:.2f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Judge pictures, print the figures, and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.silhouettes",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--count", type=int, default=1000, help="photographs of one object (1000)")
    parser.add_argument("--seed", type=int, default=31, help="of the photographs (31)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (2)")
    parser.add_argument("--out", type=Path, help="write page, figures and examples into this folder")
    options = parser.parse_args(arguments)
    many = {kind: options.count if kind == ONE else max(1, options.count // 5) for kind in KINDS}
    pictures = [(kind, number) for kind, count in many.items() for number in range(count)]
    command = f"python -m benchmarks.silhouettes --count {options.count} --seed {options.seed}"
    try:
        make_folder(options.out)
        with Pool(options.jobs) as pool:
            results = pool.map(partial(judged, seed=options.seed), pictures, chunksize=4)
            masks = pool.map(partial(mask_overlap, seed=options.seed), range(max(1, options.count // 5)), chunksize=4)
    except CazslError as error:
        sys.exit(f"error: {error}")
    print(json.dumps(summary(results, masks), indent=1))
    if options.out is None:
        print("\nnext: --out FOLDER writes this by condition, with the cost and a picture of examples")
    else:
        write(options.out, command, options.seed, results, masks)
        print(f"\nwrote {options.out}; next: look at {options.out / EXAMPLES_FILE}")


if __name__ == "__main__":
    main()
