"""Loading of a version: verify, create the predictor, run the self-check."""

from service.model.loaded_model import LoadedModel, PredictorFactory
from service.model.self_check import check_itself
from service.registry.registry import Registry


def load_version(registry: Registry, load: PredictorFactory, name: str, version: int) -> LoadedModel:
    """A version, verified in the written order: format, sizes, digests, tensors, self-check.

    Raises:
        BrokenModelError: it fails one of them.
    """
    verified = registry.read(name, version)
    predictor = load(verified.model, verified.manifest.context_kind)
    check_itself(verified.manifest, predictor)
    return LoadedModel(verified.manifest, verified.card, predictor)
