"""Answers to ``POST /v1/rollout``: sequences of pushes become clouds of poses, and clouds become JSON."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from service.api.planning.answers import of_all_rows, planning_answer, step_documents
from service.api.planning.objects import check_length, find_object
from service.inference.object_model import ObjectModel
from service.inference.pushes import reach_m
from service.inference.query import Answer
from service.inference.snapshot import Snapshot
from service.planning.particles import Region
from service.planning.rollout import Rollout, rollout
from service.pushing.poses import DoubleArray
from service.schemas.planning.rollouts import RolloutRequest, check_reach, push_rows
from service.turns import pause
from service.validity.rollouts import rollout_warnings


def answer_rollout(models: Snapshot, request: RolloutRequest) -> Answer:
    """Answer with the moments of the particles after each push. Blocking: it predicts each particle.

    Raises:
        RequestError: the pushes, the context or the reference to the model are not valid, or there are too many.
        ModelNotReadyError: see ``Snapshot.find``.
        PredictionError, DeadlineError: see ``query.predict``.
    """
    listed = request.asked_sequences()
    total = sum(map(len, listed))
    particles, start = request.particle_count(total), request.start()
    asked = find_object(models, request, request.context)
    sequences = _read_sequences(asked, request, listed)
    region = None if request.region is None else request.region.region()
    shares = np.full((3, len(sequences), max(map(len, sequences))), np.nan)
    documents: list[dict[str, Any]] = [{}] * len(sequences)
    for rows in _of_one_length(sequences):
        found = rollout(asked, start, np.stack([sequences[row] for row in rows]), particles, request.seed)
        steps = found.miss_probability.shape[1]
        shares[:, rows, :steps] = found.miss_probability, found.inside_probability, found.unfamiliar_probability
        for row, document in zip(rows, _documents(found, region, request.return_particles), strict=True):
            documents[row] = document
    is_many = request.sequences is not None
    of_object = of_all_rows(asked.object_warnings(request.sent_angles()), len(sequences) if is_many else total)
    warnings = (*rollout_warnings(shares, is_many), *of_object)
    body = {"sequences": documents} if is_many else documents[0]
    return planning_answer(asked, "world", body, warnings, total)


def _read_sequences(asked: ObjectModel, request: RolloutRequest, listed: Sequence[Any]) -> list[DoubleArray]:
    """Return the pushes (k, 4) of each sequence, in the world."""
    reach, start, found = reach_m(asked.contexts.kind), request.start(), []
    for number, sequence in enumerate(listed):
        where = "body.pushes" if request.sequences is None else f"body.sequences.{number}"
        rows = push_rows(sequence)
        for place, length_m in enumerate(rows[:, 3].tolist()):
            check_length(asked, length_m, f"{where}.{place}.length")
        check_reach(rows, start, reach, where)
        found.append(rows)
        pause()
    return found


def _of_one_length(sequences: Sequence[DoubleArray]) -> list[list[int]]:
    """Return the numbers of the sequences, those of one length together."""
    groups: defaultdict[int, list[int]] = defaultdict(list)
    for number, sequence in enumerate(sequences):
        groups[len(sequence)].append(number)
    return list(groups.values())


def _documents(found: Rollout, region: Region | None, with_particles: bool) -> list[dict[str, Any]]:
    """Return the documents of sequences of one length."""
    documents: list[dict[str, Any]] = [{"steps": steps} for steps in step_documents(found)]
    if region is not None:
        for document, share in zip(documents, region.probability(found.particles[:, -1]).tolist(), strict=True):
            document["region_probability"] = share
    if with_particles:
        for document, particles in zip(documents, found.particles, strict=True):
            document["particles"] = particles
    return documents
