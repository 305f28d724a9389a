"""Push maps over HTTP: pushes from around an object, and the objects that have one."""

from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from service.schemas.shapes import OUTLINE_EXAMPLE
from service.schemas.supports import SUPPORT_EXAMPLE
from tests.service.api.v1.requests import answer, fault

BOX = {"outline": OUTLINE_EXAMPLE}


@pytest.mark.parametrize("context", [BOX, {"descriptor": "1a2b3c4a"}])
def test_a_map_has_the_predictions_of_its_pushes(shipped: TestClient, context: dict[str, Any]) -> None:
    """Mean and std are those that a batch of the same pushes has."""
    found = answer(shipped, "/v1/push-map", {"context": context, "angles": [0.0]})
    batch = answer(shipped, "/v1/predict/batch", {"pushers": found["pushers"], "contexts": [context]})
    assert np.array(found["mean"]) == pytest.approx(np.array(batch["mean"]), abs=1e-6)
    assert np.array(found["std"]) == pytest.approx(np.array(batch["std"]), abs=1e-6)
    assert found["frame"] == "object"


def test_every_list_has_one_value_for_each_push(shipped: TestClient) -> None:
    """Spacing and angles give the number of pushes, all of which touch a box."""
    found = answer(shipped, "/v1/push-map", {"context": BOX, "spacing": 0.02, "angles": [-0.3, 0.3], "length": 0.03})
    columns = ("pushers", "points", "mean", "std", "contact", "effectiveness", "uncertainty")
    assert {len(found[name]) for name in columns} == {2 * 20}
    assert all(found["contact"])
    assert found["length"] == 0.03


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"context": {"visual": [[0.5] * 32] * 32}}, "body.context"),
        ({"context": {"support": SUPPORT_EXAMPLE}}, "body.context"),
        ({"spacing": 1e-320}, "body.spacing"),
        ({"angles": []}, "body.angles"),
        ({"angles": [1.6]}, "body.angles.0"),
        ({"context": {"descriptor": "1a2b3c4a"}, "length": 0.1}, "body.length"),
    ],
)
def test_a_map_that_cannot_be_made_is_refused(shipped: TestClient, fields: dict[str, Any], where: str) -> None:
    """The only fault names its field."""
    response = shipped.post("/v1/push-map", json={"context": BOX, **fields})
    assert fault(response)[0] == where
