"""Recipes: one small TOML file per model, with all that its training depends on besides the data."""

import math
import tomllib
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, Final

from service.errors import DataError
from service.files import read_text
from service.model.reference import is_name
from service.model.tensors import ContextKind
from training.networks.angles import PushForm
from training.networks.encoders import CHANNELS
from training.networks.methods import METHODS, ContextUse, Method
from training.omnipush.published import Split, all_objects, different_objects, different_surfaces, different_weights

SET_UPS: Final[dict[str, Callable[[], Split]]] = {
    "all-objects": all_objects,
    "different-objects": different_objects,
    "different-surfaces": different_surfaces,
    **{f"different-weights-{count}": partial(different_weights, count) for count in (0, 1, 2)},
}
DIFFERENT_FAMILIES: Final = "different-families"
ALL_FAMILIES: Final = "all-families"
SHAPE_SET_UPS: Final = (DIFFERENT_FAMILIES, ALL_FAMILIES)  # of tables of shapes, see shape_samples
PRECISIONS: Final = ("auto", "float32", "bfloat16")


@dataclass(frozen=True)
class Recipe:
    """Recipe of one training run."""

    name: str  # of the model in the registry
    method: str  # a row of the paper's tables
    context: str  # kind of context: none, indicator, visual, shape or support
    set_up: str
    epochs: int
    batch_objects: int  # objects per mini-batch, each with all its pushes
    learning_rate: float  # of Adam (with warm-up, the highest rate)
    warm_up_steps: int  # steps to the highest rate, which then falls with the root of the step (0: a constant rate)
    lambda_1: float
    lambda_2: float
    precision: str  # of the wide matrix products: float32, bfloat16, or auto (bfloat16 where it is native)
    seed: int
    # Beyond the paper. Every default is the paper's training, and a record leaves out fields that have their default.
    angle: str = "raw"  # of the push, as input of the first layer: see PushForm
    symmetries: bool = False  # turn and mirror each object of a batch at random
    no_contact: float = 0.0  # share of pushes that are replaced by pushes without contact
    least_std: float = 0.0  # added to every predicted std, normalised: the noise that remains with a perfect model
    beta: float = 0.0  # of beta-NLL: the likelihood of a push is weighted by its std to the power 2 beta
    camera_views: int = 0  # of each object of a visual context; an epoch shows each object by one view or its drawing
    encoder_channels: int = CHANNELS  # of the convolutions that encode a view
    cooling_epochs: int = 0  # last epochs, over which the learning rate falls to 0 along half a cosine

    def network(self) -> Method:
        """Return the method that the recipe names."""
        return METHODS[self.method]

    @property
    def context_kind(self) -> ContextKind:
        """Return the kind of context that the network takes."""
        return ContextKind(self.context)

    def split(self) -> Split:
        """Return the split: the objects to train on and those to hold out."""
        return SET_UPS[self.set_up]()

    def record(self) -> dict[str, str | int | float | bool]:
        """Return the recipe as a flat document, without fields that have their default."""
        found = {field.name: (getattr(self, field.name), field.default) for field in fields(self)}
        return {name: value for name, (value, default) in found.items() if value != default}


def read_recipe(name_or_path: str) -> Recipe:
    """Read a recipe: by name one that ships with the trainer, by path any TOML file.

    Raises:
        DataError: there is no such recipe, or a field is missing, unknown or impossible.
    """
    path = Path(name_or_path)
    shipped = resources.files("training.recipes").joinpath(f"{path.name}.toml")
    if path.suffix == ".toml" and path.exists():
        try:
            return parse_recipe(read_text(path), name_or_path)
        except OSError as error:
            raise DataError(f"{name_or_path}: cannot be read: {error.strerror}") from error
    if path.name != name_or_path or not shipped.is_file():
        raise DataError(f"there is no recipe {name_or_path}; give one of {', '.join(recipe_names())} or a .toml file")
    return parse_recipe(shipped.read_text(encoding="utf-8"), name_or_path)


def parse_recipe(text: str, where: str) -> Recipe:
    """Parse the text of a recipe file.

    Raises:
        DataError: the text is not TOML, or a field is wrong. The message names the field.
    """
    try:
        values = tomllib.loads(text)
    except ValueError as error:  # not TOML, or a number of thousands of digits
        raise DataError(f"{where}: not TOML: {error}") from error
    except RecursionError as error:
        raise DataError(f"{where}: nested too deep; a recipe has names and values only") from error
    return parse_recipe_record(values, where)


def parse_recipe_record(values: dict[str, Any], where: str) -> Recipe:
    """Parse a recipe from a flat document, as a recipe file or a run's record holds it.

    Raises:
        DataError: a field is missing, unknown or impossible. The message names it.
    """
    wanted = {field.name: field.type for field in fields(Recipe)}
    required = {field.name for field in fields(Recipe) if field.default is MISSING}
    if not required <= set(values) <= set(wanted):
        odd = ", ".join(sorted((required - set(values)) | (set(values) - set(wanted))))
        raise DataError(f"{where}: missing or unknown: {odd}; a recipe has {', '.join(wanted)}")
    for key, value in values.items():
        kind = wanted[key]
        if type(value) is not kind:
            raise DataError(f"{where}: {key} is {value!r}; expected {getattr(kind, '__name__', kind)}")
    if values["method"] not in METHODS:
        raise DataError(f"{where}: method is {values['method']!r}; expected one of {', '.join(METHODS)}")
    set_ups = SHAPE_SET_UPS if values["context"] == ContextKind.SHAPE else tuple(SET_UPS)
    if values["set_up"] not in set_ups:
        raise DataError(f"{where}: set_up is {values['set_up']!r}; expected one of {', '.join(set_ups)}")
    method = METHODS[values["method"]]
    kinds = [str(kind) for kind in ContextKind if method.takes(kind)]
    kinds += [str(ContextKind.SUPPORT)] if method.neural_process else []
    kinds += [str(ContextKind.SHAPE)] if method.context_use is ContextUse.MASKED else []
    if values["context"] not in kinds:
        accepted = f"{' or '.join(kinds)} with {values['method']}"
        raise DataError(f"{where}: context is {values['context']!r}; expected {accepted}")
    if values["precision"] not in PRECISIONS:
        raise DataError(f"{where}: precision is {values['precision']!r}; expected one of {', '.join(PRECISIONS)}")
    for key in ("epochs", "batch_objects", "learning_rate"):
        if not 0 < values[key] < math.inf:
            raise DataError(f"{where}: {key} is {values[key]}; expected more than 0")
    for key in ("lambda_1", "lambda_2", "warm_up_steps", "seed"):
        if not 0 <= values[key] < math.inf:
            raise DataError(f"{where}: {key} is {values[key]}; expected 0 or more")
    _check_beyond_paper(Recipe(**values), where)
    if not is_name(values["name"]):
        raise DataError(f"{where}: name is {values['name']!r}; expected lower-case letters, digits, '-' and '_'")
    return Recipe(**values)


def _check_beyond_paper(recipe: Recipe, where: str) -> None:
    """Check the fields that have defaults."""
    if recipe.angle not in list(PushForm):
        raise DataError(f"{where}: angle is {recipe.angle!r}; expected one of {', '.join(PushForm)}")
    if not 0.0 <= recipe.no_contact < 1.0:
        raise DataError(f"{where}: no_contact is {recipe.no_contact}; expected 0 or more, and less than 1")
    if not 0.0 <= recipe.least_std < math.inf:
        raise DataError(f"{where}: least_std is {recipe.least_std}; expected 0 or more")
    if not 0.0 <= recipe.beta <= 1.0:
        raise DataError(f"{where}: beta is {recipe.beta}; expected 0 to 1")
    if recipe.encoder_channels < 1:
        raise DataError(f"{where}: encoder_channels is {recipe.encoder_channels}; expected 1 or more")
    if recipe.camera_views < 0 or (recipe.camera_views > 0 and recipe.context_kind is not ContextKind.VISUAL):
        raise DataError(f"{where}: camera_views is {recipe.camera_views}; expected 0, or more with a visual context")
    if not 0 <= recipe.cooling_epochs <= recipe.epochs:
        raise DataError(f"{where}: cooling_epochs is {recipe.cooling_epochs}; expected 0 to all {recipe.epochs} epochs")


def recipe_names() -> list[str]:
    """Return the names of the recipes that ship with the trainer."""
    files = resources.files("training.recipes").iterdir()
    return sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml"))
