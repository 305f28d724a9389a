"""Gauges and counters of models, threads and admission, with their names in Prometheus."""

import platform
from collections.abc import Mapping
from typing import Protocol

import service
from service.background.supervision import Supervisor
from service.inference.loaded_models import LoadedModels
from service.inference.readiness import Readiness
from service.observability.prometheus import Reading, Readings

Rows = list[tuple[tuple[str, ...], float]]


class Traffic(Protocol):
    """Counts of admitted requests. ``transport.admission.Admission`` keeps them."""

    @property
    def in_flight(self) -> int:
        """Return the number of requests that are being answered."""
        ...

    @property
    def held_bytes(self) -> int:
        """Return the bytes of requests in memory."""
        ...


class Connected(Protocol):
    """Counts of connections. ``connections.listener.Listener`` keeps them."""

    @property
    def count(self) -> int:
        """Return the number of open connections."""
        ...

    @property
    def unsent_bytes(self) -> int:
        """Return the bytes of answers that their clients have not taken."""
        ...


class Pool(Protocol):
    """Counts of a thread pool. ``transport.threads.ThreadPool`` keeps them."""

    threads: int

    @property
    def jobs(self) -> int:
        """Return the number of jobs that wait, work or pause."""
        ...


class KeyCounts(Protocol):
    """Counts of API keys. ``transport.keys.Keys`` keeps them."""

    problems: tuple[str, ...]

    @property
    def count(self) -> int:
        """Return the number of keys that are accepted."""
        ...


def gauges(
    models: LoadedModels,
    readiness: Readiness,
    threads: Pool,
    admission: Traffic,
    connected: Connected,
    keys: KeyCounts,
    supervisor: Supervisor,
    dropped_lines: Mapping[str, int],
) -> Readings:
    """Return the readings of served models, readiness, requests in progress, API keys, background tasks and the log."""
    return Readings(
        (
            *_of_the_process(readiness, threads, admission),
            *_of_connections(connected),
            *_of_models(models, readiness),
            *_of_registry(models),
            *_of_keys(keys),
            *_of_tasks(supervisor, dropped_lines),
        )
    )


def _of_the_process(readiness: Readiness, threads: Pool, admission: Traffic) -> tuple[Reading, ...]:
    build = (service.__version__, platform.python_version())
    return (
        Reading(
            "cazsl_build_info",
            "Always 1. The labels are the versions of the service and of Python.",
            ("version", "python"),
            lambda: [(build, 1)],
        ),
        Reading("cazsl_ready", "1 if /readyz answers 200.", (), lambda: _one(readiness.is_ready())),
        Reading(
            "cazsl_draining",
            "1 after SIGTERM: the service finishes requests and is not ready.",
            (),
            lambda: _one(readiness.draining),
        ),
        Reading(
            "cazsl_requests_in_flight",
            "Requests that are being answered, without those for health.",
            (),
            lambda: _one(admission.in_flight),
        ),
        Reading(
            "cazsl_request_bytes_held", "Bytes of request bodies in memory.", (), lambda: _one(admission.held_bytes)
        ),
        Reading(
            "cazsl_worker_jobs",
            "Large batches and images in a thread or waiting for one.",
            (),
            lambda: _one(threads.jobs),
        ),
        Reading("cazsl_worker_threads", "Threads for large batches and images.", (), lambda: _one(threads.threads)),
    )


def _of_connections(connected: Connected) -> tuple[Reading, ...]:
    return (
        Reading("cazsl_connections", "Open connections.", (), lambda: _one(connected.count)),
        Reading(
            "cazsl_unsent_bytes",
            "Bytes of answers that their clients have not read.",
            (),
            lambda: _one(connected.unsent_bytes),
        ),
    )


def _of_models(models: LoadedModels, readiness: Readiness) -> tuple[Reading, ...]:
    counters = models.counters
    return (
        Reading(
            "cazsl_model_ready",
            "1 if the last self-check of the loaded version passed.",
            ("model", "version"),
            lambda: [((check.name, str(check.version)), float(check.ready)) for check in readiness.checks()],
        ),
        Reading(
            "cazsl_alias_version",
            "Version that the alias names in this process.",
            ("model", "alias"),
            lambda: [(names, float(version)) for names, version in models.snapshot.aliases.items()],
        ),
        Reading(
            "cazsl_model_loads",
            "Versions that passed every check and were loaded.",
            ("model",),
            lambda: _by_name(counters.loads),
            counts=True,
        ),
        Reading(
            "cazsl_model_releases",
            "Versions that were unloaded.",
            ("model",),
            lambda: _by_name(counters.releases),
            counts=True,
        ),
        Reading(
            "cazsl_model_load_failures",
            "Failed attempts to load a version. Every poll tries again.",
            ("model",),
            lambda: _by_name(counters.failures),
            counts=True,
        ),
        Reading(
            "cazsl_alias_swaps",
            "Changes of the version that an alias names.",
            ("model", "alias"),
            lambda: [(names, float(count)) for names, count in list(counters.swaps.items())],
            counts=True,
        ),
        Reading(
            "cazsl_model_probe_failures",
            "Self-checks that raised an error, gave another output, or did not end in time.",
            ("model",),
            lambda: _by_name(readiness.failures),
            counts=True,
        ),
    )


def _of_registry(models: LoadedModels) -> tuple[Reading, ...]:
    return (
        Reading(
            "cazsl_registry_up",
            "1 if the last poll could read the registry.",
            (),
            lambda: _one(models.counters.registry_up),
        ),
        Reading(
            "cazsl_registry_problems",
            "Problems of the registry that /readyz lists.",
            (),
            lambda: _one(len(models.snapshot.problems)),
        ),
        Reading(
            "cazsl_model_problems",
            "Problems of a model, or of an entry in a model's place, that /readyz lists.",
            ("model",),
            lambda: _by_name(models.snapshot.problem_counts),
        ),
        Reading(
            "cazsl_registry_failures",
            "Polls that could not read the registry.",
            (),
            lambda: _one(models.counters.registry_failures),
            counts=True,
        ),
    )


def _of_keys(keys: KeyCounts) -> tuple[Reading, ...]:
    return (
        Reading("cazsl_keys", "API keys that are accepted. 0 if keys are off.", (), lambda: _one(keys.count)),
        Reading(
            "cazsl_keys_problems",
            "Problems of the file of API keys that /readyz lists.",
            (),
            lambda: _one(len(keys.problems)),
        ),
    )


def _of_tasks(supervisor: Supervisor, dropped_lines: Mapping[str, int]) -> tuple[Reading, ...]:
    return (
        Reading(
            "cazsl_task_age_seconds",
            "Time since the last success of a background task, or 0 while it has no work.",
            ("task",),
            lambda: [((health.name,), health.age_s()) for health in supervisor.health()],
        ),
        Reading(
            "cazsl_task_late",
            "1 if a background task has had no success for several of its intervals: it hangs, or fails each time.",
            ("task",),
            lambda: [((health.name,), float(health.is_late())) for health in supervisor.health()],
        ),
        Reading(
            "cazsl_task_failures",
            "Failures of a background task. It was started again after each.",
            ("task",),
            lambda: [((health.name,), float(health.failures)) for health in supervisor.health()],
            counts=True,
        ),
        Reading(
            "cazsl_log_lines_dropped",
            "Lines of the log that were not written, because too many waited or the stream failed.",
            ("cause",),
            lambda: _by_name(dropped_lines),
            counts=True,
        ),
    )


def _one(value: float) -> Rows:
    return [((), float(value))]


def _by_name(counts: Mapping[str, int]) -> Rows:
    return [((name,), float(count)) for name, count in list(counts.items())]
