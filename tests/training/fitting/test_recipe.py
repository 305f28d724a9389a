"""Recipes: those that ship with the trainer, and the field that is named when a recipe is refused."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest

from service.errors import DataError
from service.model.reference import is_name
from service.model.tensors import ContextKind
from training.fitting.recipe import Recipe, parse_recipe, parse_recipe_record, read_recipe, recipe_names
from training.networks.methods import METHODS
from training.omnipush.published import different_objects
from training.paper.experiments import Cell, experiments

OMNIPUSH = ["push-indicator", "push-none", "push-visual"]


def toml_of(values: dict[str, object]) -> str:
    """Render a recipe file of these fields."""
    texts = {key: str(value).lower() if isinstance(value, bool) else repr(value) for key, value in values.items()}
    return "".join(f"{key} = {text}\n" for key, text in texts.items())


def test_six_recipes_ship() -> None:
    """The paper's recipe and one recipe for each kind of context ship with the trainer."""
    assert recipe_names() == sorted(["paper", "push-anp", "push-shape", *OMNIPUSH])


def test_the_served_meta_learner_is_trained_like_the_others() -> None:
    """Its recipe takes supports, holds objects out, and has the frame, the symmetries and the misses of push-none."""
    found, other = read_recipe("push-anp"), read_recipe("push-none")
    same = ("set_up", "batch_objects", "angle", "symmetries", "no_contact", "least_std", "beta")

    assert (found.name, found.method, found.context_kind) == ("push-anp", "ANP", "support")
    assert [getattr(found, name) for name in same] == [getattr(other, name) for name in same]


def test_only_a_neural_process_takes_supports(recipe: Recipe) -> None:
    """A network without support points is refused with supports as its context."""
    with pytest.raises(DataError, match="context is 'support'; expected none with FCN"):
        parse_recipe_record({**asdict(recipe), "method": "FCN", "context": "support"}, "here")
    assert (
        parse_recipe_record({**asdict(recipe), "method": "ANP", "context": "support"}, "here").network().neural_process
    )


@pytest.mark.parametrize("name", OMNIPUSH)
def test_a_served_recipe_augments_the_paper_s_method(name: str) -> None:
    """A served recipe has its model's name, held-out objects, symmetries, misses and the frame of the push."""
    found = read_recipe(name)

    assert found.name == name
    assert is_name(found.name)
    assert found.context_kind == name.removeprefix("push-")
    assert found.network() is METHODS["FCN" if name == "push-none" else "FCN + CM"]
    assert found.split() == different_objects()
    assert (found.angle, found.symmetries) == ("push-frame", True)
    assert 0.0 < found.no_contact < 0.5


def test_the_paper_s_recipe_is_a_row_of_its_tables() -> None:
    """The recipe ``paper`` equals the one that ``reproduce`` trains: 3000 epochs, 64 objects, lambdas 0.01 and 10."""
    found = read_recipe("paper")
    row = experiments()["different-objects"].recipe(Cell("different-objects", found.method, "indicator"), seed=0)

    assert replace(row, name=found.name) == found
    assert (found.epochs, found.batch_objects, found.learning_rate) == (3000, 64, 0.002)
    assert (found.method, found.lambda_1, found.lambda_2) == ("FCN + CM + L2Reg", 0.01, 10.0)


def test_a_record_reads_back_as_the_recipe(recipe: Recipe) -> None:
    """Parsing the record of a recipe gives the recipe."""
    assert parse_recipe_record(dict(recipe.record()), "a record") == recipe


def test_a_recipe_file_is_read_by_path(recipe: Recipe, tmp_path: Path) -> None:
    """Any TOML file with the fields of a recipe is read by its path."""
    path = tmp_path / "mine.toml"
    path.write_text(toml_of(asdict(replace(recipe, name="mine"))), encoding="utf-8")

    assert read_recipe(str(path)) == replace(recipe, name="mine")


BEYOND_PAPER = {
    "angle": "circular",
    "symmetries": True,
    "no_contact": 0.1,
    "least_std": 0.02,
    "beta": 0.5,
    "camera_views": 4,
    "encoder_channels": 8,
    "cooling_epochs": 2,
}


@pytest.mark.parametrize(("field", "value"), BEYOND_PAPER.items())
def test_fields_beyond_the_paper_are_optional_and_recorded_if_used(recipe: Recipe, field: str, value: object) -> None:
    """A recipe without an optional field is the paper's, and its record omits the field."""
    recipe = replace(recipe, context="visual") if field == "camera_views" else recipe
    assert field not in recipe.record()
    better = parse_recipe_record({**recipe.record(), field: value}, "here")

    assert better == replace(recipe, **{field: value})  # type: ignore[arg-type]  # one field of each type
    assert better.record() == {**recipe.record(), field: value}


def test_every_optional_field_is_tested() -> None:
    """``BEYOND_PAPER`` lists all fields that have a default."""
    assert set(asdict(read_recipe("paper"))) - set(read_recipe("paper").record()) == set(BEYOND_PAPER)


@pytest.mark.parametrize("field", [name for name in Recipe.__dataclass_fields__ if name not in BEYOND_PAPER])
def test_every_field_of_the_paper_is_required_and_named_when_missing(recipe: Recipe, field: str) -> None:
    """A recipe without one of the paper's fields is refused by the name of that field."""
    values = asdict(recipe)
    del values[field]

    with pytest.raises(DataError, match=rf"here: missing or unknown: {field};"):
        parse_recipe(toml_of(values), "here")


def test_an_unknown_field_is_named(recipe: Recipe) -> None:
    """A recipe with a misspelt field is refused by the name of that field."""
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
        pytest.param("symmetries", 1, "bool", id="a number for a truth"),
    ],
)
def test_a_mistyped_field_is_named(recipe: Recipe, field: str, value: object, expected: str) -> None:
    """A field of a wrong type is refused with its name, its value and the expected type."""
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
        pytest.param("angle", "square", id="an unknown angle"),
        pytest.param("no_contact", 1.0, id="no pushes with contact"),
        pytest.param("least_std", float("inf"), id="an infinite std"),
        pytest.param("beta", 1.5, id="a beta beyond 1"),
        pytest.param("camera_views", 3, id="camera views of an indicator"),
        pytest.param("encoder_channels", 0, id="an encoder without channels"),
        pytest.param("cooling_epochs", 4, id="more cooling than epochs"),
        pytest.param("seed", -1, id="a negative seed, which no generator takes"),
        pytest.param("name", "Push Indicator", id="a name that no registry takes"),
    ],
)
def test_an_impossible_field_is_named(recipe: Recipe, field: str, value: object) -> None:
    """A value that cannot be trained or published is refused before the training, by field and value."""
    with pytest.raises(DataError) as caught:
        parse_recipe_record({**asdict(recipe), field: value}, "here")

    assert f"here: {field} is {value!r}" in str(caught.value)
    assert "expected" in str(caught.value)


@pytest.mark.parametrize(("method", "kinds"), [("FCN", "none"), ("ANP", "none or support")])
def test_a_method_without_context_takes_no_indicator(recipe: Recipe, method: str, kinds: str) -> None:
    """A method without use for a context is refused with one, and the message lists its kinds of context."""
    with pytest.raises(DataError, match=rf"context is 'indicator'; expected {kinds} with {method}"):
        parse_recipe_record({**asdict(recipe), "method": method}, "here")


def test_a_recipe_for_serving_trains_on_all_objects(recipe: Recipe) -> None:
    """The set-up ``all-objects`` trains on all 250 objects and holds none out."""
    split = parse_recipe_record({**asdict(recipe), "set_up": "all-objects"}, "here").split()

    assert (split.name, len(split.train), split.test) == ("all-objects", 250, ())


@pytest.mark.parametrize("set_up", ["different-surfaces", *(f"different-weights-{count}" for count in (0, 1, 2))])
def test_every_set_up_of_the_paper_can_be_named(recipe: Recipe, set_up: str) -> None:
    """The split of each of the paper's set-ups carries the set-up's name."""
    assert parse_recipe_record({**asdict(recipe), "set_up": set_up}, "here").split().name == set_up


def test_a_file_that_is_not_toml_is_refused() -> None:
    """Text that is not TOML is refused with its place and the parser's message."""
    with pytest.raises(DataError, match="here: not TOML: "):
        parse_recipe("epochs: 3", "here")


@pytest.mark.parametrize(
    "name",
    ["push-smell", "nowhere.toml", "../recipes/push-none", ""],
    ids=["unknown", "no such file", "not a name", "empty"],
)
def test_an_unknown_recipe_lists_those_that_exist(name: str) -> None:
    """The error for an unknown recipe lists the name of every recipe that ships."""
    with pytest.raises(
        DataError, match=r"paper, push-anp, push-indicator, push-none, push-shape, push-visual or a \.toml file"
    ):
        read_recipe(name)


def test_the_recipe_of_shapes_holds_families_out() -> None:
    """The recipe of any shape masks by a shape, and is measured on families never seen."""
    found = read_recipe("push-shape")

    assert (found.context_kind, found.set_up) == (ContextKind.SHAPE, "different-families")
    assert found.network() is METHODS["FCN + CM"]
