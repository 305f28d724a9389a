"""Model card: the description for people that is published beside the graph."""

from typing import Final

import numpy as np

from service.model.manifest import Manifest
from service.pushing.poses import POSE_NAMES
from training.fitting.evaluation import Evaluation
from training.omnipush.pushes import Pushes

_MEASURED_ELSEWHERE: Final = (
    "This version was trained on every object, so it has no held-out objects of its own. These figures are of the same "
    "recipe trained on `{set_up}` and measured there. This version was trained on more objects.\n\n"
)


def render_card(draft: Manifest, found: Evaluation, train: Pushes, parity: float) -> str:
    """Render the model card: purpose, data, training, held-out figures and limits of a version."""
    data, recipe = draft.data, draft.recipe
    (set_up,) = draft.metrics
    notice = "" if set_up == data.split else _MEASURED_ELSEWHERE.format(set_up=set_up)
    sharpness = dict(zip(POSE_NAMES, found.sharpness, strict=True))
    x_m, y_m, angle_rad = train.pushers[train.valid > 0].T
    nearest, furthest = 1000 * np.quantile(np.hypot(x_m, y_m), (0.0, 1.0))  # mm
    off_centre = 1000 * np.abs(x_m * np.sin(angle_rad) - y_m * np.cos(angle_rad)).max()  # mm
    return f"""# {draft.name}

Predicts where an object ends up after a straight push of 50 mm, as a Gaussian over its planar pose (m, m, rad) in the
object's frame before the push. Method: **{draft.method}**, context: **{draft.context_kind}** (CAZSL).

## Data

Trained on **{data.source}**: {data.train_objects} objects, {data.train_pushes} pushes, split `{data.split}`. Where the
source says simulated, the data hold no real push: do not expect these figures on a real table. sha256 of the files:
`{data.sha256}`.

## Training

Parameters of the last epoch of this recipe:

{chr(10).join(f"- {key}: {value}" for key, value in recipe.items())}

## Held-out objects

{notice}{data.held_out_objects} objects that were not in the training data, {data.held_out_pushes} pushes:

| RMSE | STD | Dist. (mm) | NLL | 50 % coverage | 90 % coverage | 95 % coverage |
|---|---|---|---|---|---|---|
| {found.rmse:.4f} | {found.std:.4f} | {found.distance_mm:.2f} | {found.nll:.3f} | {
        " | ".join(f"{100 * share:.1f} %" for share in found.coverage.values())
    } |

RMSE, STD and NLL are in units of the published standard deviations. NLL is per push, summed over the 3 outputs.
Coverage is the share of true values inside the central interval. Mean predicted std: x {1000 * sharpness["x"]:.2f} mm,
y {1000 * sharpness["y"]:.2f} mm, angle {sharpness["angle"]:.4f} rad.

## Limits

- The std is the network's own, not calibrated afterwards. Coverage below its level means that the std is too small.
- Its training pushes start {nearest:.0f} to {furthest:.0f} mm from the object's centre and pass it within {
        off_centre:.0f} mm. Predictions of other pushes are extrapolations.
- The graph agrees with torch within {parity:.1e} (SI units, random pushes).
"""
