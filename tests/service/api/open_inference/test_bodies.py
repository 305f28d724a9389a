"""Bodies of the Open Inference Protocol are read with the bounds of the service."""

from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.api.open_inference.bodies import INFERENCE, LARGEST_RANK, UNSUPPORTED, InferRequestBody
from service.errors import InvalidRequestError
from service.schemas.body import validate_body
from service.schemas.rows import MAX_PUSHES
from tests.service.api.open_inference.tensors import PUSHES, URL, changed, document, error, numbers, tensor


@pytest.mark.parametrize("name", INFERENCE)
def test_examples_of_requests_are_valid(name: str) -> None:
    """Each documented example is a valid request."""
    assert validate_body(InferRequestBody, INFERENCE[name]["value"]).inputs


def test_fields_that_the_service_does_not_use_are_ignored() -> None:
    """A request may have fields and parameters of the protocol that this service does not use."""
    body = document(sequence="x", parameters={"priority": 1}, outputs=[{"name": "mean", "extra": 1}])
    assert validate_body(InferRequestBody, body).parameters == {"priority": 1}


@pytest.mark.parametrize(
    ("body", "where"),
    [
        (document(inputs=[]), "inputs"),
        (document(inputs=[tensor("pusher", PUSHES)] * 7), "inputs"),
        (document(outputs=[{"name": "mean"}] * 4), "outputs"),
        (document(id="x" * 257), "id"),
        (changed(0, shape=[MAX_PUSHES + 1, 3]), "inputs.0.shape.0"),
        (changed(0, shape=[1] * (LARGEST_RANK + 1)), "inputs.0.shape"),
        (changed(0, datatype="BYTES"), "inputs.0.datatype"),
    ],
    ids=["no inputs", "seven inputs", "four outputs", "a long id", "many pushes", "a high rank", "another type"],
)
def test_a_body_outside_of_its_bounds_is_refused(body: Any, where: str) -> None:
    """A list, a shape, an id or a type beyond its bounds is refused with its field."""
    with pytest.raises(InvalidRequestError) as raised:
        validate_body(InferRequestBody, body, prefix=())
    assert raised.value.faults[0].where == where


@pytest.mark.parametrize("value", [[], [[1]] * 3, {"a": {}}, None, "x" * 10_000, 1.5], ids=repr)
def test_parameters_of_other_servers_are_ignored_whatever_they_are(client: TestClient, value: Any) -> None:
    """Parameters that are not ours are left alone: of the request, of an input and of an output, of any type."""
    parameters = {"priority": value, "n" * 10_000: value}
    body = document(parameters=parameters, outputs=[{"name": "mean", "parameters": parameters}])
    body["inputs"][0]["parameters"] = parameters
    assert numbers(client.post(URL, json=body))["mean"].shape == (2, 3)


@pytest.mark.parametrize("name", UNSUPPORTED)
def test_shared_memory_and_classifications_are_refused(client: TestClient, name: str) -> None:
    """A tensor in shared memory or a classification is refused by name: the client would wait for another answer."""
    parameters = {"parameters": {name: "region", "other": 1}}
    for body, where in (
        (document(outputs=[{"name": "std"}, {"name": "mean", **parameters}]), "outputs.1"),
        (changed(1, **parameters), "inputs.1"),
    ):
        found = error(client.post(URL, json=body))
        assert found.startswith(f"{where}.parameters.{name}: received a parameter that is not supported; accepted is ")
    assert numbers(client.post(URL, json=changed(1, parameters={name: None})))
