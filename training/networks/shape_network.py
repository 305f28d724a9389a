"""Shape network as it is served: mechanics, the residual that a push network adds, Gaussians in SI units, and a domain.

The domain is that of the pushes and the objects that a version vouches for.
"""

from typing import Final

import torch
from torch import Tensor, nn

from service.pushing.shape_context import SILHOUETTE_SIZE
from training.networks.angles import wrapped
from training.networks.contact import clearance
from training.networks.familiarity import FeatureRanges, FeatureSpace
from training.networks.mechanics import Mechanics, PushMechanics
from training.networks.push_network import PushNetwork
from training.networks.shape_features import context_inputs, push_inputs, residual_unit

LEAST_STD_M: Final = 1e-4  # also that of a push that misses by far, whose mean is exactly at rest
LEAST_STD_RAD: Final = 1e-3
# A push that misses by less than what is not known of the object's place may touch. With a place of this std, the tip
# is deeper than the outline by sqrt(E max(0, n - u)^2), n normal and u the clearance. This is so within 5 % to u = 2.
PLACE_STD_M: Final = 1e-3
_TOUCHING, _FALL, _FALL_FASTER = 0.71, 0.85, 0.125
# The network has no unit of length, and what is not known of a place is more of a small object than of a large one.
SMALL_M: Final = 0.02
PUSH_FEATURES: Final = ("length_m", "length_over_size", "start_over_size")
OBJECT_FEATURES: Final = ("size_m", "friction", "pusher_radius_over_size", "centre_of_mass_over_size")
AXES: Final = 128  # with 64, combs and springs were as familiar as held-out objects
FALSE_ALARMS: Final = 0.0015  # of each threshold, among silhouettes that the axes were not fitted to
KEPT_BACK: Final = 6  # every sixth object is kept from the axes and sets the thresholds
MARGIN: Final = 0.02  # of a range, at both ends


class ShapeDomain(nn.Module):
    """Distances of pushes and objects from those of the drawn shapes that a model was trained on."""

    def __init__(self) -> None:
        """Create the domain. Until ``fit``, nothing is familiar."""
        super().__init__()
        self.pushes = FeatureRanges(PUSH_FEATURES)
        self.objects = FeatureRanges(OBJECT_FEATURES)
        self.silhouettes = FeatureSpace(SILHOUETTE_SIZE**2, AXES)

    def fit(self, pusher: Tensor, silhouette: Tensor, body: Tensor, context_index: Tensor) -> "ShapeDomain":
        """Fit the domain to training pushes (n, 4) and their objects. Silhouettes count turned and mirrored, too."""
        self.pushes.fit(push_features(pusher, body[context_index]), margin=MARGIN)
        self.objects.fit(object_features(body), margin=MARGIN)
        kept = torch.arange(len(silhouette)) % KEPT_BACK == KEPT_BACK - 1
        fitted, familiar = (_symmetric(silhouette[which]).flatten(1) for which in (~kept, kept))
        self.silhouettes.fit(fitted, familiar, FALSE_ALARMS)
        return self

    def forward(self, pusher: Tensor, silhouette: Tensor, body: Tensor, context_index: Tensor) -> Tensor:
        """Return the distances (n, 2) of pushes (n, 4), and of the objects that they meet."""
        objects = torch.maximum(self.objects(object_features(body)), self.silhouettes(silhouette.flatten(1)))
        pushes = self.pushes(push_features(pusher, torch.index_select(body, 0, context_index)))
        return torch.stack([pushes, torch.index_select(objects, 0, context_index)], dim=1)

    def ranges(self) -> dict[str, list[float]]:
        """Return [low, high] of each named feature, for the manifest."""
        return self.pushes.ranges() | self.objects.ranges()


def push_features(pusher: Tensor, body: Tensor) -> Tensor:
    """Return the features (n, 3) of pushes (n, 4) of objects with bodies (n, 11)."""
    size = body[:, 2]
    away = pusher[:, :2] - body[:, 0:2]
    start = torch.sqrt((away * away).sum(dim=1))
    return torch.stack([pusher[:, 3], pusher[:, 3] / size, start / size], dim=1)


def object_features(body: Tensor) -> Tensor:
    """Return the features (g, 4) of bodies (g, 11)."""
    size = body[:, 2]
    away = body[:, 3:5] - body[:, 0:2]
    centre = torch.sqrt((away * away).sum(dim=1))
    return torch.stack([size, body[:, 7], body[:, 9] / size, centre / size], dim=1)


def _symmetric(views: Tensor) -> Tensor:
    """Return silhouettes (n, 1, 32, 32) in all 8 turned and mirrored forms, (8 n, 1, 32, 32)."""
    both = torch.cat([views, views.flip(-2)])
    return torch.cat([torch.rot90(both, quarters, (-2, -1)) for quarters in range(4)])


class ShapeNetwork(nn.Module):
    """Network of any shape with SI units in and out, as the ONNX interface of shape models has it.

    Its deviations are the network's times ``scale``, and of an object smaller than ``SMALL_M`` also times their ratio
    to the power ``small``. With a ``domain`` it also gives the unfamiliarity of each push.
    """

    def __init__(
        self, network: PushNetwork, domain: ShapeDomain | None = None, scale: float = 1.0, small: float = 0.0
    ) -> None:
        """Take a fitted network of residuals."""
        super().__init__()
        self.mechanics = PushMechanics()
        self.network = network
        self.domain = domain
        self.scale = scale
        self.small = small
        self.least = nn.Buffer(torch.tensor([LEAST_STD_M, LEAST_STD_M, LEAST_STD_RAD]) ** 2, persistent=False)

    def forward(
        self,
        pusher: Tensor,
        silhouette: Tensor,
        outline: Tensor,
        support: Tensor,
        body: Tensor,
        context_index: Tensor,
    ) -> tuple[Tensor, ...]:
        """Predict mean and std (n, 3) of pushes (n, 4) of objects with these tensors, in the caller's frame.

        With a domain, the third output is the unfamiliarity (n, 2).
        """
        found = self.mechanics(pusher, outline, support, body, context_index)
        conditioning = self.network.conditioning(context_inputs(silhouette, body))
        if conditioning is not None:
            conditioning = torch.index_select(conditioning, 0, context_index)
        rows = torch.index_select(body, 0, context_index)
        mean, log_std = self.network.gaussian(push_inputs(found, pusher, rows), conditioning)
        unit = residual_unit(found.left)
        wider = torch.pow(torch.clamp(SMALL_M / rows[:, 2:3], min=1.0), self.small)
        std = torch.exp(log_std) * unit * (wider * self.scale)
        near_m = near_miss(clearance(pusher, torch.index_select(outline, 0, context_index), rows[:, 9:10]))
        gaussian = self._in_object_frame(found, found.motion + mean * unit, std, near_m, pusher, rows)
        if self.domain is None:
            return gaussian
        return *gaussian, self.domain(pusher, silhouette, body, context_index)

    def _in_object_frame(
        self, found: Mechanics, motion: Tensor, std: Tensor, near_m: Tensor, pusher: Tensor, body: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the Gaussian of the object's pose, of motions of the centroid (n, 3) in the push frame, in sizes.

        Pushes that miss have the deviations ``near_m`` (n, 1).

        The origin of the frame turns about the centroid c, from c to c + d - R(yaw) c. Its variance is propagated.
        """
        size, centroid = body[:, 2:3], body[:, 0:2]
        angle, yaw = pusher[:, 2:3], motion[:, 2:]
        along, aside = motion[:, :1] * size, motion[:, 1:2] * size
        cos, sin = torch.cos(angle), torch.sin(angle)
        moved = torch.cat([along * cos - aside * sin, along * sin + aside * cos], dim=1)
        x, y = centroid[:, :1], centroid[:, 1:]
        turn_cos, turn_sin = torch.cos(yaw), torch.sin(yaw)
        turned = torch.cat([turn_cos * x - turn_sin * y, turn_sin * x + turn_cos * y], dim=1)
        variance = std * std
        ahead, beside, turning = variance[:, :1] * size * size, variance[:, 1:2] * size * size, variance[:, 2:]
        spread = torch.cat([cos * cos * ahead + sin * sin * beside, sin * sin * ahead + cos * cos * beside], dim=1)
        lever = torch.cat([turned[:, 1:], turned[:, :1]], dim=1)
        spread = torch.cat([spread + lever * lever * turning, turning], dim=1)
        hit = found.touches[:, None]
        mean = torch.cat([centroid + moved - turned, wrapped(yaw)], dim=1) * hit
        missed = torch.cat([near_m, near_m, near_m / size], dim=1) * (1.0 - hit)
        return mean, torch.sqrt(spread * hit + missed * missed + self.least)


def near_miss(clearance_m: Tensor) -> Tensor:
    """Return the std in m of how far an object moves that the tip passes by with these clearances."""
    places = clearance_m / PLACE_STD_M
    return PLACE_STD_M * _TOUCHING * torch.exp(-places * (_FALL + _FALL_FASTER * places))
