"""The paper's experiments as data: their cells, their tables with the paper's figures, and the paper's claims.

A table is a set-up and a kind of context. Its rows are methods. A cell is a method with its context on a set-up, and is
trained once per seed. ANP and FCN take no context, so the tables of one set-up share their cells, as in the paper.
The paper's own figures are in ``paper_tables.toml``.
"""

import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from importlib import resources
from typing import Final

from service.model.tensors import ContextKind
from training.fitting.recipe import Recipe
from training.networks.methods import (
    ANP,
    FCN,
    FCN_CC,
    FCN_CM,
    FCN_CM_L2REG,
    FCN_CM_NEURALREG,
    METHODS,
    ContextDistance,
    ContextUse,
)

GAUSSIAN_PROCESS: Final = "gaussian-process"
PUSHING: Final = ("different-objects", "different-surfaces", "different-weights")
EXPERIMENTS: Final = (GAUSSIAN_PROCESS, *PUSHING)
NONE: Final = str(ContextKind.NONE)
INDICATOR: Final = str(ContextKind.INDICATOR)
VISUAL: Final = str(ContextKind.VISUAL)
KERNEL_PARAMETERS: Final = "kernel parameters"
CAZSL: Final = (FCN_CM, FCN_CM_L2REG, FCN_CM_NEURALREG)
# the two sub-cases in which the paper's meta-learning baseline is best
ANP_WINS: Final = (("different-weights-1", INDICATOR), ("different-weights-2", INDICATOR))


@dataclass(frozen=True)
class Cell:
    """Cell: a method on a set-up, given a kind of context."""

    set_up: str
    method: str
    context: str

    @property
    def slug(self) -> str:
        """Return a name for folders, of lower-case letters, digits and '-'."""
        words = f"{self.method} {self.context}" if self.context != NONE else self.method
        return "-".join(words.lower().replace("+", " ").split())


@dataclass(frozen=True)
class PaperFigures:
    """Figures of a row of a table of the paper, in normalised units. The regression has no distance."""

    rmse: float
    std: float
    distance_mm: float | None = None


class Rule(StrEnum):
    """Rule for comparing the errors of two groups of cells."""

    ALL = "all"  # every lower cell is below every higher cell
    BEST = "best"  # the best of the lower cells is below the best of the higher cells
    EACH = "each"  # the first is below the first, the second below the second


@dataclass(frozen=True)
class Claim:
    """Claim of the paper about the errors (RMSE) in a table."""

    text: str
    lower: tuple[Cell, ...]
    higher: tuple[Cell, ...]
    rule: Rule = Rule.ALL

    def holds(self, rmse: Mapping[Cell, float]) -> bool:
        """Return whether the claim holds for these errors."""
        lower, higher = [rmse[cell] for cell in self.lower], [rmse[cell] for cell in self.higher]
        if self.rule is Rule.EACH:
            return all(low < high for low, high in zip(lower, higher, strict=True))
        return (min(lower) if self.rule is Rule.BEST else max(lower)) < min(higher)


@dataclass(frozen=True)
class Table:
    """Table of the paper, or the part of one with a single set-up and kind of context."""

    set_up: str
    context: str
    paper: Mapping[str, PaperFigures]
    claims: tuple[Claim, ...]

    @property
    def title(self) -> str:
        """Return the heading: set-up and context in words."""
        return f"{self.set_up.replace('-', ' ').capitalize()}, context: {self.context}"

    def cell(self, method: str) -> Cell:
        """Return the cell of a row."""
        return cell(self.set_up, method, self.context)


@dataclass(frozen=True)
class Experiment:
    """Experiment: tables that one command reproduces, with the number of seeds and epochs of each cell."""

    name: str
    tables: tuple[Table, ...]
    seeds: int
    epochs: int
    batch_objects: int
    lambdas: Mapping[str, tuple[float, float]]  # by kind of context
    precision: str
    cooling_epochs: int = 0  # last epochs, over which the rate falls to 0 (the paper's is constant)

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Return the distinct cells, in the order of the tables."""
        return tuple(dict.fromkeys(table.cell(method) for table in self.tables for method in table.paper))

    def without(self, methods: Collection[str]) -> "Experiment":
        """Return the experiment without the rows of these methods and without the claims that need them."""
        left = []
        for table in self.tables:
            gone = {table.cell(method) for method in table.paper if method in methods}
            claims = tuple(claim for claim in table.claims if not gone & {*claim.lower, *claim.higher})
            rows = {method: figures for method, figures in table.paper.items() if method not in methods}
            left.append(replace(table, paper=rows, claims=claims))
        return replace(self, tables=tuple(left))

    def recipe(self, wanted: Cell, seed: int, epochs: int | None = None) -> Recipe:
        """Return the recipe of a cell, as the paper trains it."""
        method = METHODS[wanted.method]
        lambda_1 = lambda_2 = 0.0
        if method.distance is not ContextDistance.NONE:
            lambda_1, lambda_2 = self.lambdas[wanted.context]
        if method.distance is ContextDistance.KERNEL:
            lambda_2 = 1.0  # the trained phi includes the scale
        return Recipe(
            name=wanted.slug,
            method=wanted.method,
            context=wanted.context,
            set_up=wanted.set_up,
            epochs=epochs or self.epochs,
            batch_objects=self.batch_objects,
            learning_rate=0.001 if method.neural_process else 0.002,
            warm_up_steps=2000 if method.neural_process else 0,
            lambda_1=lambda_1,
            lambda_2=lambda_2,
            precision=self.precision,
            seed=seed,
            cooling_epochs=self.cooling_epochs,
        )


def cell(set_up: str, method: str, context: str) -> Cell:
    """Return the cell of a method. Methods that use no context have kind ``none``."""
    return Cell(set_up, method, NONE if METHODS[method].context_use is ContextUse.NONE else context)


def experiments() -> dict[str, Experiment]:
    """Return all experiments of the paper by name, in its order."""
    text = resources.files("training.paper").joinpath("paper_tables.toml").read_text(encoding="utf-8")
    tables = tuple(
        _table(set_up, context, {method: PaperFigures(*figures) for method, figures in rows.items()})
        for set_up, contexts in tomllib.loads(text).items()
        for context, rows in contexts.items()
    )

    def of(name: str) -> tuple[Table, ...]:
        """Return the tables of one experiment, which has one set-up or three."""
        return tuple(table for table in tables if table.set_up.startswith(name))

    return {
        GAUSSIAN_PROCESS: Experiment(
            GAUSSIAN_PROCESS,
            of(GAUSSIAN_PROCESS),
            seeds=10,
            epochs=500,
            batch_objects=32,
            lambdas={KERNEL_PARAMETERS: (0.0001, 10.0)},
            precision="float32",
        ),
        **{
            name: Experiment(
                name,
                of(name),
                seeds=3,
                epochs=3000,
                batch_objects=64,
                lambdas={INDICATOR: (0.01, 10.0), VISUAL: (0.01, 0.01)},
                precision="auto",
            )
            for name in PUSHING
        },
    }


def _table(set_up: str, context: str, paper: dict[str, PaperFigures]) -> Table:
    of = {method: cell(set_up, method, context) for method in paper}
    masked = tuple(of[method] for method in CAZSL)
    claims = [Claim("Every model with a context mask beats FCN and FCN + CC.", masked, (of[FCN], of[FCN_CC]))]
    if context == KERNEL_PARAMETERS:
        others = (of[FCN_CM], of[FCN_CM_NEURALREG])
        claims.append(Claim("Concatenating the context is worse than not having it.", (of[FCN],), (of[FCN_CC],)))
        claims.append(Claim("Of the models with a mask, L2Reg is best.", (of[FCN_CM_L2REG],), others))
    elif (set_up, context) in ANP_WINS:
        claims.append(Claim("ANP beats every model with a context mask.", (of[ANP],), masked))
    else:
        claims.append(Claim("The best model with a context mask beats ANP.", masked, (of[ANP],), Rule.BEST))
    if context == INDICATOR:
        regularised = (of[FCN_CM_L2REG],), (of[FCN_CM_NEURALREG],)
        claims.append(Claim("L2Reg beats NeuralReg when the context is the indicator.", *regularised))
    if context == VISUAL:
        users = (FCN_CC, *CAZSL)
        pairs = tuple(of[method] for method in users), tuple(cell(set_up, method, INDICATOR) for method in users)
        claims.append(
            Claim("Each method is better with the visual context than with the indicator.", *pairs, Rule.EACH)
        )
    return Table(set_up, context, paper, tuple(claims))
