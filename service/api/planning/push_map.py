"""Answers to ``POST /v1/push-map``: pushes from all around an object, and how much each of them does."""

import numpy as np

from service.api.planning.answers import of_all_rows, planning_answer
from service.api.planning.objects import check_length, find_outlined_object
from service.errors import InvalidRequestError
from service.inference.query import Answer
from service.inference.snapshot import Snapshot
from service.planning.push_map import push_map, pushes_around
from service.schemas.planning.push_maps import PushMapRequest
from service.validity.rollouts import rollout_warnings


def answer_push_map(models: Snapshot, request: PushMapRequest) -> Answer:
    """Answer with a push map. Blocking: it predicts every push.

    Raises:
        RequestError: the context has no outline, the spacing is too small, or a field is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
        PredictionError, DeadlineError: see ``query.predict``.
    """
    found = find_outlined_object(models, request, request.context)
    check_length(found.model, request.length, "body.length")
    places = request.places(found.outline.perimeter_m)
    around = pushes_around(found.outline, places, request.angles, request.length, found.pusher_radius_m)
    if not len(around.pushes):
        received = f"{places} places at all of which a tip of radius {found.pusher_radius_m:g} m overlaps the object"
        raise InvalidRequestError.at("body.spacing", received, "a smaller spacing")
    made = push_map(found.model, found.outline, around)
    outcomes, pushes = made.outcomes, around.pushes
    shares = np.stack([outcomes.misses, outcomes.inside, outcomes.unfamiliar]).astype(np.float64)
    warnings = (
        *rollout_warnings(shares[:, None], by_sequence=False),
        *of_all_rows(found.model.object_warnings(()), len(pushes)),
    )
    body = {
        "pushers": np.ascontiguousarray(pushes[:, :3]),
        "points": around.points_m,
        "length": request.length,
        "mean": outcomes.mean,
        "std": outcomes.frame_std(),
        "contact": (~outcomes.misses).tolist(),
        "effectiveness": made.effectiveness,
        "uncertainty": made.uncertainty_m,
    }
    return planning_answer(found.model, "object", body, warnings, len(pushes))
