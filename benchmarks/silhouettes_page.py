"""Page of outlines found in pictures: figures by condition, and a picture of examples."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from benchmarks.photographs import LEAST_CONTRAST, LEAST_OVER_PATTERN, LONGER_SIDE, SHARES, Conditions
from benchmarks.silhouettes_cost import Cost

Example = tuple[str, npt.NDArray[np.uint8], npt.NDArray[np.bool_], npt.NDArray[np.float64] | None]
CELL: Final = (240, 190)  # pixels of an example
_TEXT: Final = 16  # pixels of its title
_COLUMNS: Final = 6
_SHARES: Final = (0.05, 0.1, 0.2, 0.4, 0.701)
_BY: Final[dict[str, Callable[[Conditions], str]]] = {
    "table": lambda one: one.table,
    "shadow": lambda one: one.shadow,
    "light": lambda one: one.light,
    "object against the table": lambda one: one.contrast,
    "surface of the object": lambda one: one.surface,
    "extent over the shorter side": lambda one: _band(one.share),
}
PAGE: Final = """# Outlines found in pictures

`{command} --out docs/results/silhouettes`

Seed {seed} chose nothing: the constants were chosen on seeds 11, 12 and 13.

Rendered photographs of one object: any family, any rotation, off the centre, {sides[0]} to {sides[1]} pixels on the
longer side, {shares[0]:.0%} to {shares[1]:.0%} of the shorter side across; on a plain table, wood, cloth or stone; lit
evenly, unevenly or by a spot; with no, a soft or a hard shadow; plain, shaded with a highlight, or printed; blurred,
with noise, as JPEG, one in ten in grey. Object and table differ by at least {contrast} of the full range in a channel
(in luma for grey ones) and by {pattern:g} standard deviations of the table's own pattern. These ranges are our
assumption; no picture of a camera is among them.

## One object

| | |
|---|---|
| photographs | {count} |
| **intersection over union of 0.9 or more** (goal: 95 %) | **{good:.1f} %** |
| ... of 0.8 or more | {near:.1f} % |
| median intersection over union | {median:.3f} |
| confident mistakes: an outline below 0.9 | {mistakes:.1f} % |
| ... of these below 0.5, a thing other than the object | {grave:.1f} % |
| false refusals | {refusals} |
| least intersection over union of masks (black and white) | {masks:.3f} |

By condition:

| condition | | photographs | 0.9 or more | mistakes | false refusals |
|---|---|---|---|---|---|
{conditions}

## Pictures without one whole object

| picture | count | refused | with the codes |
|---|---|---|---|
{others}

## Cost

Processor time of the search in these photographs: {mean:.2f} s on average, {p99:.2f} s at the 99th percentile,
{most:.2f} s at most. The hardest pictures that the service accepts, with the memory of decoding and search:

| picture | decoding | search | memory | answer |
|---|---|---|---|---|
{costs}

## Examples

Green is the outline that was found, magenta the true one where they differ. First right ones, then mistakes with their
overlap, false refusals, and pictures that shall be refused.

![Photographs with the outlines that were found](examples.jpg)
"""


def page(
    command: str,
    seed: int,
    figures: dict[str, Any],
    judged: Sequence[tuple[Conditions, bool, str]],
    costs: Sequence[Cost],
) -> str:
    """Return the page in Markdown.

    Args:
        command: that measured.
        seed: of the photographs.
        figures: of ``benchmarks.silhouettes.summary``.
        judged: conditions, success and refusal of each photograph of one object.
        costs: of the hardest pictures.
    """
    false = figures["false_refusals"]
    listed = ", ".join(f"{code} {share:.1f} %" for code, share in false.items())
    return PAGE.format(
        command=command,
        seed=seed,
        sides=LONGER_SIDE,
        shares=SHARES,
        contrast=LEAST_CONTRAST,
        pattern=LEAST_OVER_PATTERN,
        count=figures["count"],
        good=figures["good"],
        near=figures["at_least_0.8"],
        median=figures["median_overlap"],
        mistakes=figures["mistakes"],
        grave=figures["grave_mistakes"],
        refusals=f"{sum(false.values()):.1f} %" + (f" ({listed})" if listed else ""),
        masks=figures["mask_least_overlap"],
        conditions="\n".join(_rows(judged)),
        others="\n".join(_other(kind, row) for kind, row in figures["others"].items()),
        mean=figures["cpu_s"]["mean"],
        p99=figures["cpu_s"]["p99"],
        most=figures["cpu_s"]["max"],
        costs="\n".join(
            f"| {one.picture} | {one.decode_s:.2f} s | {one.search_s:.2f} s | {one.memory_mib:.0f} MiB | {one.answer} |"
            for one in costs
        ),
    )


def _rows(judged: Sequence[tuple[Conditions, bool, str]]) -> list[str]:
    rows = []
    for name, value in _BY.items():
        for kind in sorted({value(conditions) for conditions, _, _ in judged}):
            chosen = [(good, refusal) for conditions, good, refusal in judged if value(conditions) == kind]
            counts = (
                sum(good for good, _ in chosen),
                sum(not good and not refusal for good, refusal in chosen),
                sum(not good and bool(refusal) for good, refusal in chosen),
            )
            shares = " | ".join(f"{100.0 * many / len(chosen):.1f} %" for many in counts)
            rows.append(f"| {name} | {kind} | {len(chosen)} | {shares} |")
    return rows


def _band(share: float) -> str:
    place = max(1, int(np.searchsorted(_SHARES, share, side="right")))
    low, high = _SHARES[min(place, len(_SHARES) - 1) - 1], _SHARES[min(place, len(_SHARES) - 1)]
    return f"{100.0 * low:2.0f} to {100.0 * high:.0f} %"


def _other(kind: str, row: dict[str, Any]) -> str:
    codes = ", ".join(f"{code} {many}" for code, many in row["codes"].most_common())
    return f"| {kind} | {row['count']} | {row['refused']:.1f} % | {codes} |"


def draw_examples(path: Path, examples: Sequence[Example]) -> None:
    """Draw photographs with the true and the found outlines and a title each, as one JPEG."""
    lines = -(-len(examples) // _COLUMNS)
    sheet = Image.new("RGB", (_COLUMNS * CELL[0], lines * (CELL[1] + _TEXT)), "white")
    for number, example in enumerate(examples):
        left, top = number % _COLUMNS * CELL[0], number // _COLUMNS * (CELL[1] + _TEXT)
        ImageDraw.Draw(sheet).text((left + 4, top + 2), example[0], fill="black")
        sheet.paste(_cell(example), (left, top + _TEXT))
    sheet.save(path, quality=80)


def _cell(example: Example) -> Image.Image:
    """Draw one example, cut to the surroundings of the object."""
    _, levels, mask, corners = example
    rows, columns = np.nonzero(mask) if mask.any() else np.nonzero(np.ones_like(mask))
    low, high = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()]) + 1
    if corners is not None:
        low, high = np.minimum(low, corners.min(axis=0)), np.maximum(high, corners.max(axis=0))
    room = 0.35 * float((high - low).max())
    low, high = np.maximum(0, low - room), np.minimum(levels.shape[1::-1], high + room)
    factor = float(min((np.array(CELL) - 4) / (high - low)))
    size = np.maximum(1, np.round((high - low) * factor)).astype(int)
    cell = Image.fromarray(levels).resize((int(size[0]), int(size[1])), box=(*low.tolist(), *high.tolist()))
    draw = ImageDraw.Draw(cell)
    if corners is not None:
        found = [(x, y) for x, y in ((corners - low) * factor).tolist()]
        draw.line([*found, found[0]], fill=(0, 255, 0), width=2)
        true = Image.fromarray(mask).resize(cell.size, box=(*low.tolist(), *high.tolist()))
        inside = np.asarray(true)
        edge = inside & ~(
            np.roll(inside, 1, 0) & np.roll(inside, -1, 0) & np.roll(inside, 1, 1) & np.roll(inside, -1, 1)
        )
        near = Image.new("L", cell.size)
        ImageDraw.Draw(near).line([*found, found[0]], fill=255, width=5)
        levels_now = np.array(cell)
        levels_now[edge & (np.asarray(near) == 0)] = (255, 0, 255)
        cell = Image.fromarray(levels_now)
    return cell
