"""Model card of a version for objects of any shape: the description for people that is published beside the graph."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np

from service.model.manifest import Manifest
from training.fitting.evaluation import Predictions
from training.fitting.shape_evaluation import ShapeFigures
from training.fitting.shape_samples import HELD_OUT_FAMILIES, ShapeBatch

_BANDS: Final = {
    "length": (0.0, 0.01, 0.02, 0.05, 0.08, np.inf),
    "size": (0.0, 0.02, 0.04, 0.07, np.inf),
    "start from the centroid": (0.0, 0.03, 0.06, 0.09, 0.12, np.inf),
    "aim from the centroid": (0.0, 0.01, 0.02, 0.04, 0.06, np.inf),
}


def render_shape_card(draft: Manifest, figures: ShapeFigures, parity: float, scores: str = "") -> str:
    """Render the model card. ``scores`` is a text on other data, such as recorded pushes."""
    data, recipe, validity = draft.data, draft.recipe, draft.validity
    ranges = {} if validity is None else validity.ranges
    calibration = next(iter(draft.calibration.values()))
    return f"""# {draft.name}

Predicts where an object of any outline ends up after a straight push of any length, as a Gaussian over its planar pose
(m, m, rad) in the caller's frame. Method: **{draft.method}**, context: **{draft.context_kind}** (CAZSL), as a residual
on quasi-static mechanics of an object that presses evenly. Pushes that miss are exactly at rest.

## Data

Trained on **{data.source}**:
{data.train_objects} objects, {data.train_pushes} pushes, split `{data.split}`. The data hold no recorded push.
sha256 of the content: `{data.sha256}`.

## Training

Parameters of the last epoch of this recipe:

{chr(10).join(f"- {key}: {value}" for key, value in recipe.items())}

## Held-out objects

Figures of the recipe with the families {", ".join(HELD_OUT_FAMILIES)} and a tenth of the other
objects held out. Parts of each body are known at random. Only pushes that touch count.

| | pushes | RMSE | NLL | 90 % intervals | 50, 90, 95 % regions |
|---|---|---|---|---|---|
{chr(10).join(_row(name, each) for name, each in figures.predictions.items())}

RMSE and NLL are in units of the published deviations of Omnipush. A region is that of x, y and angle together.

| 90 % regions of held-out families | pushes | RMSE | hold |
|---|---|---|---|
{chr(10).join(_bands(figures))}
{scores}
## Domain

This version vouches for {validity.note if validity else "no domain"}.
The output `unfamiliarity` of its graph has the distance of each push, and of its object, from the training data: above
1 outside of the domain.

| feature | lowest | highest |
|---|---|---|
{chr(10).join(f"| {name} | {low:.4g} | {high:.4g} |" for name, (low, high) in ranges.items())}

## Limits

- Every std is the network's own times {calibration.scale:.3f}. Method: {calibration.method}.
- The spread of pressure under an object is not known. If it is far from even, the object turns otherwise.
- Torch and onnxruntime agree within {parity:.1e} (SI units, 98 % of random pushes).
"""


def _row(name: str, found: Predictions) -> str:
    figures = found.measures()
    regions = ", ".join(f"{100 * share:.1f}" for share in found.regions())
    return (
        f"| {name} | {len(found.mean)} | {figures.rmse:.4f} | {figures.nll:.3f} | {100 * figures.coverage[0.9]:.1f} % "
        f"| {regions} % |"
    )


def _bands(figures: ShapeFigures) -> Iterator[str]:
    """Yield the rows of bands of the last part."""
    name, found = list(figures.predictions.items())[-1]
    for quantity, values in _quantities(found, figures.batches[name]).items():
        for low, high in pairwise(_BANDS[quantity]):
            inside = (values >= low) & (values < high)
            if inside.any():
                part = found.select(inside)
                upper = "mm and more" if np.isinf(high) else f"to {1000 * high:.0f} mm"
                yield (
                    f"| {quantity} {1000 * low:.0f} {upper} | {len(part.mean)} | {part.measures().rmse:.4f} "
                    f"| {100 * part.regions()[1]:.1f} % |"
                )


def _quantities(found: Predictions, batch: ShapeBatch) -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Return the quantities (n,) in m by which pushes are put into bands."""
    body = batch.contexts[-1][found.objects].astype(np.float64)
    x_m, y_m = (found.inputs[:, axis] - body[:, axis] for axis in (0, 1))
    angle_rad = found.inputs[:, 2]
    return {
        "length": found.inputs[:, 3].astype(np.float64),
        "size": body[:, 2],
        "start from the centroid": np.hypot(x_m, y_m),
        "aim from the centroid": np.abs(x_m * np.sin(angle_rad) - y_m * np.cos(angle_rad)),
    }
