"""Protocol of a physical domain: the seam between a registry and the physics of its models."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind, Tensor


@dataclass(frozen=True)
class Verdict:
    """Verdict of one gate: its figure, the limit of the figure, and the meaning of both."""

    gate: str
    passed: bool
    figure: float
    limit: float
    meaning: str


class Domain(Protocol):
    """A physical domain, such as planar pushing, as far as a registry must know it.

    A registry is given a domain. It asks the domain for the tensors that a version must declare, and for the gates that
    a version must pass before an alias may name it.
    """

    def inputs(self, kind: ContextKind) -> tuple[Tensor, ...]:
        """Return the inputs that a graph of this context kind must have, in order."""
        ...

    def outputs(self, kind: ContextKind, manifest_format: int) -> tuple[tuple[Tensor, ...], ...]:
        """Return the outputs that a graph may have: each possibility has them in order."""
        ...

    def gates(self, model: LoadedModel) -> Iterable[Verdict]:
        """Run the gates that need no data on a loaded version."""
        ...
