"""Gauges and counters of models, threads and admission, under their names in Prometheus."""

import platform
from collections.abc import Mapping

import service
from service.inference.loaded_models import LoadedModels
from service.inference.readiness import Readiness
from service.observability.prometheus import Reading, Readings
from service.transport.admission import Admission
from service.transport.threads import ThreadPool

Rows = list[tuple[tuple[str, ...], float]]


def gauges(models: LoadedModels, readiness: Readiness, threads: ThreadPool, admission: Admission) -> Readings:
    """Return the readings of served models, of readiness, and of the work in progress."""
    return Readings(
        (*_of_the_process(readiness, threads, admission), *_of_models(models, readiness), *_of_registry(models))
    )


def _of_the_process(readiness: Readiness, threads: ThreadPool, admission: Admission) -> tuple[Reading, ...]:
    build = (service.__version__, platform.python_version())
    return (
        Reading("cazsl_build_info", "Always 1; its labels say what runs.", ("version", "python"), lambda: [(build, 1)]),
        Reading("cazsl_ready", "Whether /readyz says so.", (), lambda: _one(readiness.is_ready())),
        Reading(
            "cazsl_draining", "Whether SIGTERM has come: serving on, not ready.", (), lambda: _one(readiness.draining)
        ),
        Reading("cazsl_requests_in_flight", "Requests being answered.", (), lambda: _one(admission.in_flight)),
        Reading("cazsl_request_bytes_held", "Bytes of bodies held.", (), lambda: _one(admission.held_bytes)),
        Reading("cazsl_worker_jobs", "Large batches and images in threads or waiting.", (), lambda: _one(threads.jobs)),
        Reading("cazsl_worker_threads", "Threads for them, at most.", (), lambda: _one(threads.threads)),
    )


def _of_models(models: LoadedModels, readiness: Readiness) -> tuple[Reading, ...]:
    counters = models.counters
    return (
        Reading(
            "cazsl_model_ready",
            "Loaded, checked, and its last tiny inference was right.",
            ("model", "version"),
            lambda: [((check.name, str(check.version)), float(check.ready)) for check in readiness.checks()],
        ),
        Reading(
            "cazsl_alias_version",
            "The version that an alias means here.",
            ("model", "alias"),
            lambda: [(names, float(version)) for names, version in models.snapshot.aliases.items()],
        ),
        Reading(
            "cazsl_model_loads",
            "Versions that passed every check and are served.",
            ("model",),
            lambda: _by_name(counters.loads),
            counts=True,
        ),
        Reading(
            "cazsl_model_releases",
            "Versions that are served no more.",
            ("model",),
            lambda: _by_name(counters.releases),
            counts=True,
        ),
        Reading(
            "cazsl_model_load_failures",
            "Attempts at a version that failed a check; tried again at every look.",
            ("model",),
            lambda: _by_name(counters.failures),
            counts=True,
        ),
        Reading(
            "cazsl_alias_swaps",
            "Times that an alias came to mean another version.",
            ("model", "alias"),
            lambda: [(names, float(count)) for names, count in list(counters.swaps.items())],
            counts=True,
        ),
        Reading(
            "cazsl_model_probe_failures",
            "Tiny inferences that failed, gave something else, or did not end.",
            ("model",),
            lambda: _by_name(readiness.failures),
            counts=True,
        ),
    )


def _of_registry(models: LoadedModels) -> tuple[Reading, ...]:
    return (
        Reading(
            "cazsl_registry_up",
            "Whether the last look saw the registry.",
            (),
            lambda: _one(models.counters.registry_up),
        ),
        Reading(
            "cazsl_registry_problems", "Problems that /readyz lists.", (), lambda: _one(len(models.snapshot.problems))
        ),
        Reading(
            "cazsl_registry_failures",
            "Looks at the registry that failed.",
            (),
            lambda: _one(models.counters.registry_failures),
            counts=True,
        ),
    )


def _one(value: float) -> Rows:
    return [((), float(value))]


def _by_name(counts: Mapping[str, int]) -> Rows:
    return [((name,), float(count)) for name, count in list(counts.items())]
