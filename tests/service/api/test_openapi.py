"""The OpenAPI document has each error as the service writes it, and an example of each answer."""

from typing import Any

from service.api.openapi import ERRORS, give_examples, problems, protocol_errors, state_media_type
from service.errors import InvalidImageError, InvalidRequestError, UnknownModelError
from service.schemas.problems import ProblemBody
from service.transport.problems import MEDIA_TYPE


def test_errors_of_a_route_are_grouped_by_status() -> None:
    """Two errors with one status are two examples of one response, and refer to the components."""
    found = problems(ProblemBody, UnknownModelError, InvalidRequestError, InvalidImageError)
    assert list(found) == [404, 422]
    assert found[422]["content"][MEDIA_TYPE]["examples"] == {
        "invalid_request": {"$ref": "#/components/examples/v1_invalid_request"},
        "invalid_image": {"$ref": "#/components/examples/v1_invalid_image"},
    }


def test_an_error_with_its_own_message_is_written_out() -> None:
    """An error that a route gives in place of a class is an example with its document."""
    error = InvalidRequestError.at("path.name", "a text of 65 characters", "at most 64 characters")
    (response,) = problems(ProblemBody, error).values()
    example = response["content"][MEDIA_TYPE]["examples"]["invalid_request"]
    assert (example["summary"], example["value"]["detail"]) == (error.title, str(error))


def test_an_invalid_request_is_a_400_in_the_other_protocol() -> None:
    """The Open Inference Protocol has its own status and media type."""
    found = protocol_errors(ProblemBody, InvalidRequestError)
    assert list(found) == [400]
    assert list(found[400]["content"]) == ["application/json"]


def test_there_is_one_example_of_each_class() -> None:
    """Every class of error has exactly one example, with its own code."""
    codes = [error.code for error in ERRORS]
    assert len(set(codes)) == len(codes)


def document(schema: dict[str, Any], responses: dict[str, Any]) -> dict[str, Any]:
    """Return a document with one route, and one schema with the name Body."""
    operation = {"parameters": [{"schema": {"examples": ["push-none"]}}], "responses": responses}
    return {"paths": {"/": {"get": operation}}, "components": {"schemas": {"Body": schema}}}


def test_an_answer_without_an_example_has_those_of_its_fields() -> None:
    """An example is built from the fields that are always present, and a parameter has its first example."""
    fields = {"name": {"examples": ["a", "b"]}, "note": {"anyOf": [{"type": "null"}], "examples": ["c"]}}
    answer = {"200": {"content": {"application/json": {"schema": {"$ref": "#/components/schemas/Body"}}}}}
    found = give_examples(document({"properties": fields}, answer))["paths"]["/"]["get"]
    assert found["parameters"][0]["example"] == "push-none"
    examples = found["responses"]["200"]["content"]["application/json"]["examples"]
    assert examples == {"Body": {"value": {"name": "a"}}}


def test_only_errors_that_a_route_refers_to_are_in_the_document() -> None:
    """The components have the examples of the routes, and no other."""
    (response,) = problems(ProblemBody, UnknownModelError).values()
    examples = give_examples(document({}, {"404": {"content": response["content"]}}))["components"]["examples"]
    assert list(examples) == ["v1_unknown_model"]
    assert examples["v1_unknown_model"]["value"]["code"] == "unknown_model"


def test_problems_have_their_media_type() -> None:
    """A response with the schema of a problem is declared as application/problem+json."""
    media = {"schema": {"$ref": "#/components/schemas/ProblemBody"}}
    found = state_media_type(document({}, {"404": {"content": {"application/json": media}}}))
    assert found["paths"]["/"]["get"]["responses"]["404"]["content"] == {MEDIA_TYPE: media}
