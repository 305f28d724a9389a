"""Model card: the description for people that is published beside the graph."""

from typing import Final

from service.model.manifest import Manifest
from service.pushing.poses import POSE_NAMES
from training.fitting.bands import bands
from training.fitting.evaluation import Evaluation, Predictions

MEASURED_ELSEWHERE: Final = (
    "This version was trained on every object, so it has no held-out objects of its own. These figures are of the same "
    "recipe trained on `{set_up}` and measured there. This version was trained on more objects.\n\n"
)
_CAMERA_NOTE: Final = """

`camera` is the same pushes with contexts from 4 camera views of each object: other light, table, place, blur and noise.
"""


def render_card(draft: Manifest, figures: dict[str, Predictions], parity: float) -> str:
    """Render the model card: purpose, data, training, held-out figures by band, domain and limits of a version.

    ``figures`` are the calibrated held-out predictions by the name of the set-up, those of drawings before those of
    camera views.
    """
    data, recipe = draft.data, draft.recipe
    set_up = next(iter(figures))
    notice = "" if set_up == data.split else MEASURED_ELSEWHERE.format(set_up=set_up)
    found = {name: each.measures() for name, each in figures.items()}
    sharpness = dict(zip(POSE_NAMES, found[set_up].sharpness, strict=True))
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

| | RMSE | STD | Dist. (mm) | NLL | 50 % coverage | 90 % coverage | 95 % coverage |
|---|---|---|---|---|---|---|---|
{chr(10).join(_row(name, each) for name, each in found.items())}

RMSE, STD and NLL are in units of the published standard deviations. NLL is per push, summed over the 3 outputs.
Coverage is the share of true values inside the central interval. Mean predicted std: x {1000 * sharpness["x"]:.2f} mm,
y {1000 * sharpness["y"]:.2f} mm, angle {sharpness["angle"]:.4f} rad.{_CAMERA_NOTE if len(figures) > 1 else ""}

{chr(10).join(bands_table(name, each) for name, each in figures.items())}
Start is the distance of the tip from the object's centre before the push, aim that of the push's line.

## Domain

This version vouches for {draft.validity.note if draft.validity else "no domain"}. The output `unfamiliarity` of its
graph has the distance of each push, and of its object, from the training data: above 1 outside of the domain.

| feature | lowest | highest |
|---|---|---|
{ranges_table(draft)}

## Limits

- Every std is the network's own times {_factor(draft):.3f}, a conformal factor from held-out objects. Figures above are
  of each half of them with the factor of the other half.
- Another length than 50 mm, another pusher or another object is an extrapolation, and the service warns of it.
- The graph agrees with torch within {parity:.1e} (SI units, random pushes).
"""


def _row(name: str, found: Evaluation) -> str:
    coverage = " | ".join(f"{100 * share:.1f} %" for share in found.coverage.values())
    return f"| {name} | {found.rmse:.4f} | {found.std:.4f} | {found.distance_mm:.2f} | {found.nll:.3f} | {coverage} |"


def bands_table(name: str, found: Predictions) -> str:
    """Return the table of coverage by ring of starts and band of aims."""
    lines = [f"| {name} | pushes | RMSE | 50 % coverage | 90 % coverage | 95 % coverage |", "|---|---|---|---|---|---|"]
    for band in bands(found):
        coverage = " | ".join(f"{100 * share:.1f} %" for share in band.found.coverage.values())
        lines.append(f"| {band.name()} | {band.pushes} | {band.found.rmse:.4f} | {coverage} |")
    return "\n".join([*lines, ""])


def ranges_table(draft: Manifest) -> str:
    """Return the rows of the table of the domain."""
    ranges = {} if draft.validity is None else draft.validity.ranges
    return "\n".join(f"| {name} | {low:.4g} | {high:.4g} |" for name, (low, high) in ranges.items())


def _factor(draft: Manifest) -> float:
    """Return the factor on every deviation, 1 if there is none."""
    return next(iter(draft.calibration.values())).scale or 1.0
