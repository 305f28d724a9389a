"""Record of one model version in memory."""

from dataclasses import dataclass, field

from service.model.manifest import Manifest
from service.model.predictor import Predictor
from service.model.push_cost import PushCost


@dataclass(frozen=True)
class LoadedModel:
    """A model version that passed every check: its manifest, its card, its predictor, and the cost of its pushes."""

    manifest: Manifest
    card: str
    predictor: Predictor
    cost: PushCost = field(default_factory=PushCost, compare=False)  # of no time, until it is measured
