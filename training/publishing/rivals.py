"""Figures of held-out predictions for the manifest: of the version that is published, and of those before it.

Promotion compares a version with the champion by figures of the same data. So the versions that aliases name are
measured again on the held-out data of the version that is published.
"""

from collections.abc import Iterator

import numpy as np
import torch

from service.errors import CazslError
from service.model.manifest import Calibration, Metrics, Rival
from service.model.predictor import OnnxPredictor, Predictor
from service.model.tensors import FloatArray, Gaussians, IndexArray
from service.registry.loading import load_version
from service.registry.registry import Registry
from training.fitting.bands import LEVEL, held_out_views
from training.fitting.evaluation import COVERAGE_LEVELS, Predictions, joined
from training.fitting.samples import Samples
from training.omnipush.published import Split, published_normalisation


def measured_name(set_up: Split, views: str) -> str:
    """Return the name of the figures of a set-up and a kind of views."""
    return "-".join(filter(None, (set_up.name, views)))


def metrics_of(found: Predictions) -> Metrics:
    """Return error and likelihood of predictions."""
    figures = found.measures()
    return Metrics(figures.rmse, figures.std, figures.distance_mm, figures.nll)


def calibration_of(found: Predictions, factor: float | None = None) -> Calibration:
    """Describe the coverage of predictions, and the factor that they were scaled with. None: they were not."""
    figures = found.measures()
    coverage_50, coverage_90, coverage_95 = (figures.coverage[level] for level in COVERAGE_LEVELS)
    method = "none" if factor is None else f"conformal factor at {LEVEL:.0%}, of held-out objects"
    shares = (None, None, None) if factor is None else found.regions()
    return Calibration(method, coverage_50, coverage_90, coverage_95, list(figures.sharpness), factor, *shares)


def rivals_of(registry: Registry, name: str, set_up: Split, samples: Samples) -> dict[str, Rival] | None:
    """Measure the versions that aliases name on these held-out samples. Those that do not load are left out."""
    found = {}
    for version, predictor in named_predictors(registry, name):
        measured = {
            measured_name(set_up, views): joined([predicted(predictor, seen) for seen in each])
            for views, each in held_out_views(samples).items()
        }
        found[str(version)] = Rival(
            {each: metrics_of(figures) for each, figures in measured.items()},
            {each: calibration_of(figures) for each, figures in measured.items()},
        )
    return found or None


def named_predictors(registry: Registry, name: str) -> Iterator[tuple[int, Predictor]]:
    """Yield the versions that aliases name, with their predictors. Those that do not load are left out."""
    for version in _named(registry, name):
        try:
            yield version, load_version(registry, OnnxPredictor, name, version).predictor
        except CazslError:
            continue


def predicted(predictor: Predictor, samples: Samples) -> Predictions:
    """Return the predictions of a published version, normalised."""
    known = published_normalisation()
    present = samples.valid > 0
    inputs, outcome = (part[present].numpy() for part in (samples.inputs, samples.targets))
    objects = torch.nonzero(present)[:, 0].numpy()
    pushers = (inputs * known.input_std + known.input_mean).astype(np.float32)
    contexts = (samples.context.numpy(),) if samples.context.shape[-1] > 0 else ()
    found = predictor.predict(pushers, contexts, objects if contexts else None)
    return normalised(found, outcome, inputs, objects)


def normalised(found: Gaussians, outcome: FloatArray, inputs: FloatArray, objects: IndexArray) -> Predictions:
    """Return predictions in SI units beside outcomes and inputs (n, 3), which are normalised already."""
    known = published_normalisation()
    mean = ((found.mean - known.output_mean) / known.output_std).astype(np.float32)
    log_std = np.log(found.std / known.output_std).astype(np.float32)
    return Predictions(mean, log_std, outcome, inputs, objects, tuple(known.output_std.tolist()))


def _named(registry: Registry, name: str) -> list[int]:
    """Return the versions that aliases of a model name. A registry that is yet to be created has none."""
    try:
        return sorted(set(registry.aliases(name).values()))
    except CazslError:
        return []
