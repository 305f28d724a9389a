"""Answers of planning as JSON: the model that answered, the frame, the steps of rollouts, and warnings."""

from dataclasses import replace
from typing import Any, Final, Literal

import orjson

from service.inference.object_model import ObjectModel
from service.inference.query import Answer, Warnings
from service.planning.rollout import Rollout
from service.pushing.poses import POSE_NAMES

_JSON: Final = orjson.OPT_SERIALIZE_NUMPY


def planning_answer(
    asked: ObjectModel, frame: Literal["object", "world"], body: dict[str, Any], warnings: Warnings, pushes: int
) -> Answer:
    """Return the answer about one object.

    Args:
        asked: the model of the object, which is named.
        frame: of every pose in the answer.
        body: fields of the answer.
        warnings: of its rows.
        pushes: number of pushes that were asked about, for metrics.
    """
    name, version = asked.model.manifest.name, asked.model.manifest.version
    listed = [{"code": warning.code, "detail": warning.detail, "rows": warning.rows} for warning in warnings]
    document = {"model": {"name": name, "version": version}, "frame": frame, **body, "warnings": listed}
    return Answer(orjson.dumps(document, option=_JSON), name, version, pushes)


def of_all_rows(warnings: Warnings, count: int) -> Warnings:
    """Return warnings about the object as warnings of every row of an answer."""
    return tuple(replace(warning, rows=tuple(range(count))) for warning in warnings)


def step_documents(found: Rollout) -> list[list[dict[str, Any]]]:
    """Return the documents of the steps of each sequence."""
    mean, covariance = found.moments()
    shares = found.miss_probability, found.inside_probability, found.unfamiliar_probability
    names = "miss_probability", "inside_probability", "unfamiliar_probability"
    columns = {name: share.tolist() for name, share in zip(names, shares, strict=True)}
    return [
        [
            {
                "mean": dict(zip(POSE_NAMES, pose, strict=True)),
                "covariance": covariance[row, step],
                **{name: column[row][step] for name, column in columns.items()},
            }
            for step, pose in enumerate(poses)
        ]
        for row, poses in enumerate(mean.tolist())
    ]
