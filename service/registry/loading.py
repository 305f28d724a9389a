"""Load a version: verify it, create its predictor, run its self-check."""

from service.model.loaded_model import LoadedModel
from service.model.predictor import PredictorFactory
from service.model.self_check import measure_cost
from service.registry.registry import Registry


def load_version(registry: Registry, load: PredictorFactory, name: str, version: int) -> LoadedModel:
    """Load a version, checked in this order: format, sizes, digests, tensors, self-check.

    Raises:
        BrokenModelError: it fails one of the checks.
    """
    verified = registry.read(name, version)
    manifest = verified.manifest
    predictor = load(verified.model, manifest.inputs, manifest.outputs)
    cost = measure_cost(manifest, predictor)
    return LoadedModel(manifest, verified.card, predictor, cost)
