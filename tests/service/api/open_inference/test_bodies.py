"""Bodies of the Open Inference Protocol are read with the bounds of the service."""

from typing import Any

import pytest

from service.api.open_inference.bodies import INFERENCE, LARGEST_RANK, InferRequestBody
from service.errors import InvalidRequestError
from service.schemas.body import validate_body
from service.schemas.rows import MAX_PUSHES
from tests.service.api.open_inference.tensors import PUSHES, changed, document, tensor


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
        (document(inputs=[tensor("pusher", PUSHES)] * 4), "inputs"),
        (document(outputs=[{"name": "mean"}] * 3), "outputs"),
        (document(id="x" * 257), "id"),
        (changed(0, shape=[MAX_PUSHES + 1, 3]), "inputs.0.shape.0"),
        (changed(0, shape=[1] * (LARGEST_RANK + 1)), "inputs.0.shape"),
        (changed(0, datatype="BYTES"), "inputs.0.datatype"),
    ],
    ids=["no inputs", "four inputs", "three outputs", "a long id", "many pushes", "a high rank", "another type"],
)
def test_a_body_outside_of_its_bounds_is_refused(body: Any, where: str) -> None:
    """A list, a shape, an id or a type beyond its bounds is refused with its field."""
    with pytest.raises(InvalidRequestError) as raised:
        validate_body(InferRequestBody, body, prefix=())
    assert raised.value.faults[0].where == where
