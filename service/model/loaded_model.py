"""Record of one model version in memory."""

from dataclasses import dataclass

from service.model.manifest import Manifest
from service.model.predictor import Predictor


@dataclass(frozen=True)
class LoadedModel:
    """A model version that passed every check: its manifest, its card and its predictor."""

    manifest: Manifest
    card: str
    predictor: Predictor
