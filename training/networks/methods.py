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
    neural_process: bool = False  # needs support pushes of the object: not zero-shot

    def takes(self, kind: str) -> bool:
        """Return whether the paper trains the method with contexts of this kind. Methods without one take ``none``.

        The paper's tables have no shapes, and draw the support of a neural process from its pushes.
        """
        return kind not in (ContextKind.SHAPE, ContextKind.SUPPORT) and (kind == ContextKind.NONE) == (
            self.context_use is ContextUse.NONE
        )


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
