"""Methods: the rows of the paper's tables, under the paper's names, and how each uses the context of an object."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from service.model.tensors import ContextKind


class ContextUse(StrEnum):
    """Use of the context in a network (paper section III and section IV, the list of competing methods)."""

    NONE = "none"
    CONCATENATED = "concatenated"  # CC: concatenated with the input of the first layer
    MASKED = "masked"  # CM: a factor on each activation of the first layer


class ContextDistance(StrEnum):
    """Distance d between two contexts in the context regulariser."""

    NONE = "none"
    EUCLIDEAN = "euclidean"  # L2Reg: |c - c'|
    KERNEL = "kernel"  # NeuralReg: phi(c) . phi(c') with a trained phi


@dataclass(frozen=True)
class Method:
    """Method: a row of the paper's tables."""

    name: str
    context_use: ContextUse = ContextUse.NONE
    distance: ContextDistance = ContextDistance.NONE
    neural_process: bool = False  # needs support pushes of the object: not zero-shot, and never served

    def takes(self, kind: str) -> bool:
        """Return whether the method is trained with contexts of this kind. Methods without a context take ``none``.

        The paper's tables have no shapes.
        """
        return kind != ContextKind.SHAPE and (kind == ContextKind.NONE) == (self.context_use is ContextUse.NONE)


ANP: Final = "ANP"
FCN: Final = "FCN"
FCN_CC: Final = "FCN + CC"
FCN_CM: Final = "FCN + CM"
FCN_CM_L2REG: Final = "FCN + CM + L2Reg"
FCN_CM_NEURALREG: Final = "FCN + CM + NeuralReg"

METHODS: Final = {
    method.name: method
    for method in (
        Method(ANP, neural_process=True),
        Method(FCN),
        Method(FCN_CC, ContextUse.CONCATENATED),
        Method(FCN_CM, ContextUse.MASKED),
        Method(FCN_CM_L2REG, ContextUse.MASKED, ContextDistance.EUCLIDEAN),
        Method(FCN_CM_NEURALREG, ContextUse.MASKED, ContextDistance.KERNEL),
    )
}
