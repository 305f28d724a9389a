"""Model card of a version that knows an object by a support of its pushes."""

from service.model.manifest import Manifest
from training.fitting.support_evaluation import DRAWS, SupportFigures
from training.publishing.card import MEASURED_ELSEWHERE, bands_table, ranges_table

_MANY, _FEW = 50, 5  # pushes in the supports whose figures are shown by band


def render_support_card(draft: Manifest, figures: SupportFigures, parity: float) -> str:
    """Render the model card: purpose, data, training, held-out figures by the number of pushes, domain and limits."""
    data, recipe = draft.data, draft.recipe
    set_up = next(iter(draft.metrics))
    notice = "" if set_up == data.split else MEASURED_ELSEWHERE.format(set_up=set_up)
    return f"""# {draft.name}

Predicts where an object ends up after a straight push of 50 mm, as a Gaussian over its planar pose (m, m, rad) in the
object's frame before the push. Method: **{draft.method}**, context: **{draft.context_kind}**, 1 to 50 pushes of the
same object with their outcomes, each in the object's frame before that push. It is the paper's meta-learner, an
attentive neural process. It is not zero-shot: nothing is known of an object without pushes of it.

## Data

Trained on **{data.source}**:
{data.train_objects} objects, {data.train_pushes} pushes, split `{data.split}`. Where the source says simulated, the
data hold no real push: do not expect these figures on a real table. sha256 of the files: `{data.sha256}`.

## Training

Parameters of the last epoch of this recipe. Supports of each step have 1 to 50 pushes, as often 1 or 2 as 20 to 50.

{chr(10).join(f"- {key}: {value}" for key, value in recipe.items())}

## Held-out objects

{notice}{data.held_out_objects} objects that were not in the training data, {data.held_out_pushes} pushes, of which
200 of each object are predicted, from {DRAWS} draws of a support of each size:

| pushes in the support | RMSE | Dist. (mm) | NLL | 50 % coverage | 90 % coverage | 95 % coverage | std times |
|---|---|---|---|---|---|---|---|
{chr(10).join(_rows(figures))}

RMSE and NLL are in units of the published standard deviations. NLL is per push, summed over the 3 outputs. Coverage is
the share of true values inside the central interval. The last column is the conformal factor on every std, which a
support of another size takes in proportion. Figures are of each half of the objects with the factor of the other half.

{bands_table(f"{_MANY} pushes", figures.predictions[_MANY])}
{bands_table(f"{_FEW} pushes", figures.predictions[_FEW])}
Start is the distance of the tip from the object's centre before the push, aim that of the push's line.

## Domain

This version vouches for {draft.validity.note if draft.validity else "no domain"}. The output `unfamiliarity` of its
graph has the distance of each push, and of the pushes in its support, from the training data: above 1 outside of the
domain.

| feature | lowest | highest |
|---|---|---|
{ranges_table(draft)}

## Limits

- A support that is wrong, of another object or in another frame, is not noticed if its pushes are possible.
- Another length than 50 mm, another pusher or another object is an extrapolation, and the service warns of it.
- Whether a push touches the object is not known before it was predicted, so no warning says that it misses.
- The graph agrees with torch within {parity:.1e} (SI units, random pushes).
"""


def _rows(figures: SupportFigures) -> list[str]:
    """Return the rows of the table, fewest pushes first."""
    rows = []
    for count, each in sorted(figures.predictions.items()):
        found = each.measures()
        shares = " | ".join(f"{100 * share:.1f} %" for share in found.coverage.values())
        error = f"{found.rmse:.4f} | {found.distance_mm:.2f} | {found.nll:.3f}"
        rows.append(f"| {count} | {error} | {shares} | {figures.factors[count]:.3f} |")
    return rows
