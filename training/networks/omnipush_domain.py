"""Domain of the models of Omnipush's objects: the pushes and the objects that a version vouches for.

A push is familiar if it starts and aims as the training pushes do. An object is familiar by its number of weights if
its context is an indicator, and by its view if it is a picture: views are compared free of exposure, in the space of
the drawings and camera views of the training objects, and their exposure by itself. An object that is known by a
support of some of its pushes is familiar if each of these starts, aims and ends as training pushes do.
"""

from typing import Final

import torch
from torch import Tensor, nn

from service.model.tensors import ContextKind
from service.pushing.contexts import BITS_PER_SIDE, SIDES, VISUAL_SIZE
from training.networks.angles import products
from training.networks.familiarity import FeatureRanges, FeatureSpace

PUSH_FEATURES: Final = ("start_distance_m", "aim_offset_m")
_AIM: Final = PUSH_FEATURES.index("aim_offset_m")
SUPPORT_FEATURES: Final = (
    "support_nearest_start_m",
    "support_furthest_start_m",
    "support_furthest_aim_m",
    "support_furthest_move_m",
    "support_largest_turn_rad",
)
SUPPORT_MARGIN: Final = 0.05
_SIDED: Final = slice(2, None)  # of which training pushes only come close to zero
_FAR_M: Final = 1e3  # beyond every push
WEIGHT_FEATURES: Final = ("weights",)
EXPOSURE_FEATURES: Final = ("view_mean", "view_contrast")
VIEW_AXES: Final = 96
FALSE_ALARMS: Final = 0.003  # of each threshold, among views of objects that the axes were not fitted to
KEPT_BACK: Final = 6  # every sixth object is kept from the axes and sets the thresholds
_WEIGHT_BITS: Final = [[float(bit % BITS_PER_SIDE >= 5)] for bit in range(SIDES * BITS_PER_SIDE)]  # of b, c, B and C
_OFFSET: Final = [[0.0], [0.0], [1.0], [-1.0]]  # of a line from the centre: x sin - y cos
_LEAST_CONTRAST: Final = 0.02  # below it a view is noise, which is not scaled up further


class OmnipushDomain(nn.Module):
    """Distances of pushes and objects from those of Omnipush that a model was trained on."""

    def __init__(self, kind: ContextKind) -> None:
        """Create the domain of a model with this kind of context. Until ``fit``, nothing is familiar."""
        super().__init__()
        self.kind = kind
        self.pushes = FeatureRanges(PUSH_FEATURES)
        names = {ContextKind.INDICATOR: WEIGHT_FEATURES, ContextKind.VISUAL: EXPOSURE_FEATURES}.get(kind, ())
        self.objects = FeatureRanges(names)
        self.views = FeatureSpace(VISUAL_SIZE**2, VIEW_AXES) if kind is ContextKind.VISUAL else None

    def fit(self, pushers: Tensor, contexts: Tensor) -> "OmnipushDomain":
        """Fit the domain to training pushes (n, 3), in m, m, rad, and to the contexts of their objects.

        Contexts are (objects, 36), or (objects, views, 1, 32, 32): all views of an object. Views count in all turned
        and mirrored forms.
        """
        self.pushes.fit(push_features(pushers))
        self.pushes.low[_AIM] = -self.pushes.high[_AIM]  # on either side; training pushes only come close to zero
        if self.kind is ContextKind.INDICATOR:
            self.objects.fit(weights(contexts), margin=0.1)
        if self.views is not None:
            kept = torch.arange(len(contexts)) % KEPT_BACK == KEPT_BACK - 1
            fitted, familiar = (_symmetric(contexts[which].flatten(0, 1)) for which in (~kept, kept))
            self.objects.fit(exposure(contexts.flatten(0, 1)), margin=0.05)
            self.views.fit(without_exposure(fitted), without_exposure(familiar), FALSE_ALARMS)
        return self

    def forward(self, pushers: Tensor, context: Tensor | None = None, context_index: Tensor | None = None) -> Tensor:
        """Return the distances (n, 2) of pushes (n, 3), and of the objects that they meet."""
        push = self.pushes_of(pushers)
        if context is None or context_index is None:
            return torch.stack([push, torch.zeros_like(push)], dim=-1)
        return torch.stack([push, torch.index_select(self.objects_of(context), 0, context_index)], dim=-1)

    def ranges(self) -> dict[str, list[float]]:
        """Return [low, high] of each named feature, for the manifest."""
        return self.pushes.ranges() | self.objects.ranges()

    def pushes_of(self, pushers: Tensor) -> Tensor:
        """Return the distances (n,) of pushes (n, 3) by themselves."""
        distance: Tensor = self.pushes(push_features(pushers))
        return distance

    def objects_of(self, context: Tensor) -> Tensor:
        """Return the distances (objects,) of contexts."""
        if self.views is None:
            distance: Tensor = self.objects(weights(context))
            return distance
        return torch.maximum(self.views(without_exposure(context)), self.objects(exposure(context)))


class SupportDomain(nn.Module):
    """Distances of pushes, and of the supports of objects, from the pushes that a model was trained on."""

    def __init__(self) -> None:
        """Create a domain. Until ``fit``, nothing is familiar."""
        super().__init__()
        self.pushes = FeatureRanges(PUSH_FEATURES)
        self.supports = FeatureRanges(SUPPORT_FEATURES)

    def fit(self, pushers: Tensor, outcomes: Tensor) -> "SupportDomain":
        """Fit the domain to training pushes and outcomes (n, 3), in m, m, rad."""
        self.pushes.fit(push_features(pushers))
        self.pushes.low[_AIM] = -self.pushes.high[_AIM]  # on either side; training pushes only come close to zero
        single = support_features(pushers[:, None], outcomes[:, None], torch.ones(len(pushers), 1))
        self.supports.fit(single, margin=SUPPORT_MARGIN)
        self.supports.low[_SIDED] = -self.supports.high[_SIDED]
        return self

    def forward(self, pushers: Tensor, index: Tensor, support: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        """Return the distances (n, 2) of pushes (n, 3), and of the supports ``support[index]``."""
        push, known = self.pushes(push_features(pushers)), self.supports(support_features(*support))
        return torch.stack([push, torch.index_select(known, 0, index)], dim=-1)

    def ranges(self) -> dict[str, list[float]]:
        """Return [low, high] of each named feature, for the manifest."""
        return self.pushes.ranges() | self.supports.ranges()


def support_features(pushers: Tensor, outcomes: Tensor, valid: Tensor) -> Tensor:
    """Return the features (objects, 5) of supports: pushers and outcomes (objects, k, 3), valid (objects, k)."""
    start, aim = push_features(pushers).unbind(-1)
    moved, turned = torch.linalg.vector_norm(outcomes[..., :2], dim=-1), torch.abs(outcomes[..., 2])
    nearest = (start + (1.0 - valid) * _FAR_M).amin(dim=-1)
    return torch.stack([nearest, *((each * valid).amax(dim=-1) for each in (start, aim, moved, turned))], dim=-1)


def push_features(pushers: Tensor) -> Tensor:
    """Return the features (..., 2) of pushes (..., 3): distance of the start from the centre, and of the line."""
    place_m, angle_rad = torch.split(pushers, [2, 1], dim=-1)
    direction = torch.cat([torch.cos(angle_rad), torch.sin(angle_rad)], dim=-1)
    aim_m = torch.abs(products(place_m, direction) @ pushers.new_tensor(_OFFSET))
    return torch.cat([torch.linalg.vector_norm(place_m, dim=-1, keepdim=True), aim_m], dim=-1)


def weights(indicators: Tensor) -> Tensor:
    """Count the weights (objects, 1) of indicators (objects, 36)."""
    return indicators @ indicators.new_tensor(_WEIGHT_BITS)


def without_exposure(views: Tensor) -> Tensor:
    """Return views (objects, 1, 32, 32) as features (objects, 1024), less their mean and over their contrast."""
    mean, contrast = exposure(views).unbind(-1)
    return (views.flatten(1) - mean[:, None]) / (contrast[:, None] + _LEAST_CONTRAST)


def exposure(views: Tensor) -> Tensor:
    """Return mean and standard deviation of the grey levels of views, (objects, 2)."""
    levels = views.flatten(1)
    mean = levels.mean(dim=-1)
    return torch.stack([mean, torch.sqrt(torch.mean((levels - mean[:, None]) ** 2, dim=-1))], dim=-1)


def _symmetric(views: Tensor) -> Tensor:
    """Return views (n, 1, 32, 32) in all 8 turned and mirrored forms, (8 n, 1, 32, 32)."""
    both = torch.cat([views, views.flip(-2)])
    return torch.cat([torch.rot90(both, quarters, (-2, -1)) for quarters in range(SIDES)])
