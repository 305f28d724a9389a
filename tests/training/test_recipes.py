"""Recipes: those that ship, and the field that each bad one is refused for."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest

from service.contract import ContextKind
from service.errors import DataError
from service.manifest import is_name
from training.data import different_objects
from training.methods import METHODS
from training.recipes import Recipe, parse_recipe, parse_recipe_record, read_recipe, recipe_names


def toml_of(values: dict[str, object]) -> str:
    """A recipe file of these fields."""
    return "".join(f"{key} = {value!r}\n" for key, value in values.items())


def test_two_recipes_ship() -> None:
    """The paper's network and the baseline without context."""
    assert recipe_names() == ["push-indicator", "push-none"]


@pytest.mark.parametrize("name", ["push-indicator", "push-none"])
def test_shipped_recipes_parse(name: str) -> None:
    """Each is named as its model, and is the paper's training: 3000 epochs of Adam at 0.002, 64 objects a batch."""
    found = read_recipe(name)

    assert found.name == name
    assert is_name(found.name)
    assert found.network() is METHODS[found.method]
    assert found.split() == different_objects()
    assert (found.epochs, found.batch_objects, found.learning_rate) == (3000, 64, 0.002)


def test_the_shipped_recipes_are_the_paper_s_methods() -> None:
    """The indicator model is masked and regularised with lambda_1 0.01 and lambda_2 10; the other knows no object."""
    indicator, none = read_recipe("push-indicator"), read_recipe("push-none")

    assert (indicator.method, indicator.lambda_1, indicator.lambda_2) == ("FCN + CM + L2Reg", 0.01, 10.0)
    assert indicator.context_kind is ContextKind.INDICATOR
    assert none.method == "FCN"
    assert none.context_kind is ContextKind.NONE


def test_a_record_reads_back_as_the_recipe(recipe: Recipe) -> None:
    """What a run writes down of its recipe is the recipe."""
    assert parse_recipe_record(dict(recipe.record()), "a record") == recipe


def test_a_recipe_file_is_read_by_path(recipe: Recipe, tmp_path: Path) -> None:
    """Any TOML file with the fields of a recipe is one."""
    path = tmp_path / "mine.toml"
    path.write_text(toml_of(asdict(replace(recipe, name="mine"))), encoding="utf-8")

    assert read_recipe(str(path)) == replace(recipe, name="mine")


@pytest.mark.parametrize("field", list(Recipe.__dataclass_fields__))
def test_every_field_is_required_and_named_when_missing(recipe: Recipe, field: str) -> None:
    """No field has a default: a recipe is whole."""
    values = asdict(recipe)
    del values[field]

    with pytest.raises(DataError, match=rf"here: missing or unknown: {field};"):
        parse_recipe(toml_of(values), "here")


def test_an_unknown_field_is_named(recipe: Recipe) -> None:
    """A misspelt field is not quietly ignored."""
    with pytest.raises(DataError, match="here: missing or unknown: momentum;"):
        parse_recipe(toml_of({**asdict(recipe), "momentum": 0.9}), "here")


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        pytest.param("epochs", 3.0, "int", id="a fraction of epochs"),
        pytest.param("epochs", "3", "int", id="epochs as text"),
        pytest.param("learning_rate", 1, "float", id="an integer learning rate"),
        pytest.param("lambda_2", "10", "float", id="lambda as text"),
        pytest.param("name", 5, "str", id="a number for a name"),
        pytest.param("seed", True, "int", id="a truth for a seed"),
    ],
)
def test_a_mistyped_field_is_named(recipe: Recipe, field: str, value: object, expected: str) -> None:
    """The message has the field, what it is, and the type that is expected."""
    with pytest.raises(DataError) as caught:
        parse_recipe_record({**asdict(recipe), field: value}, "here")

    assert str(caught.value) == f"here: {field} is {value!r}; expected {expected}"


@pytest.mark.parametrize(
    ("field", "value"),
    [
        pytest.param("method", "FCN + XX", id="unknown method"),
        pytest.param("context", "smell", id="unknown kind of context"),
        pytest.param("context", "none", id="a mask without context"),
        pytest.param("set_up", "different-planets", id="unknown set-up"),
        pytest.param("precision", "float8", id="unknown precision"),
        pytest.param("warm_up_steps", -1, id="a negative warm-up"),
        pytest.param("epochs", 0, id="no epochs"),
        pytest.param("batch_objects", -64, id="a negative batch"),
        pytest.param("learning_rate", 0.0, id="no learning rate"),
        pytest.param("learning_rate", float("nan"), id="a learning rate that is no number"),
        pytest.param("learning_rate", float("inf"), id="an infinite learning rate"),
        pytest.param("lambda_1", float("nan"), id="a lambda that is no number"),
        pytest.param("seed", -1, id="a negative seed, which no generator takes"),
        pytest.param("name", "Push Indicator", id="a name that no registry takes"),
    ],
)
def test_an_impossible_field_is_named(recipe: Recipe, field: str, value: object) -> None:
    """What cannot be trained or published is refused before hours of training, by field and value."""
    with pytest.raises(DataError) as caught:
        parse_recipe_record({**asdict(recipe), field: value}, "here")

    assert f"here: {field} is {value!r}" in str(caught.value)
    assert "expected" in str(caught.value)


@pytest.mark.parametrize("method", ["FCN", "ANP"])
def test_a_method_without_use_for_a_context_has_none(recipe: Recipe, method: str) -> None:
    """The message says which contexts the paper has it with."""
    with pytest.raises(DataError, match=rf"context is 'indicator'; expected none with {method}"):
        parse_recipe_record({**asdict(recipe), "method": method}, "here")


@pytest.mark.parametrize("set_up", ["different-surfaces", *(f"different-weights-{count}" for count in (0, 1, 2))])
def test_every_set_up_of_the_paper_can_be_named(recipe: Recipe, set_up: str) -> None:
    """Its split carries its name."""
    assert parse_recipe_record({**asdict(recipe), "set_up": set_up}, "here").split().name == set_up


def test_a_file_that_is_not_toml_is_refused() -> None:
    """The message says where and passes on what the parser found."""
    with pytest.raises(DataError, match="here: not TOML: "):
        parse_recipe("epochs: 3", "here")


@pytest.mark.parametrize(
    "name",
    ["push-visual", "nowhere.toml", "../recipes/push-none", ""],
    ids=["unknown", "no such file", "not a name", "empty"],
)
def test_an_unknown_recipe_lists_those_that_exist(name: str) -> None:
    """The message has every name that would have worked."""
    with pytest.raises(DataError, match=r"push-indicator, push-none or a \.toml file"):
        read_recipe(name)
