"""Request bodies of planning in the OpenAPI document. A test sends every example, and it is answered."""

from typing import Final

from service.api.v1.request_examples import json_examples
from service.schemas.planning.plans import GOAL_EXAMPLE, OBSTACLE_EXAMPLE, WORKSPACE_EXAMPLE
from service.schemas.planning.rollouts import POSE_EXAMPLE, PUSH_EXAMPLE, REGION_EXAMPLE
from service.schemas.shapes import L_EXAMPLE, OUTLINE_EXAMPLE

_BOX: Final = {"outline": OUTLINE_EXAMPLE}
_ASIDE: Final = {"x": 0.43, "y": 0.02, "angle": 1.5708, "length": 0.05}

SEQUENCES: Final = json_examples(
    {
        "two pushes of a box, and the probability of a region": {
            "context": _BOX,
            "object_pose": POSE_EXAMPLE,
            "pushes": [PUSH_EXAMPLE, _ASIDE],
            "region": REGION_EXAMPLE,
        },
        "two candidate sequences": {
            "context": {"outline": L_EXAMPLE, "friction": 0.3},
            "object_pose": POSE_EXAMPLE,
            "sequences": [[PUSH_EXAMPLE], [_ASIDE, PUSH_EXAMPLE]],
            "particles": 64,
            "seed": 7,
        },
        "an object by its descriptor, with the particles": {
            "context": {"descriptor": "1a2b3c4a"},
            "object_pose": POSE_EXAMPLE,
            "pushes": [PUSH_EXAMPLE],
            "particles": 8,
            "return_particles": True,
        },
    }
)
AROUND: Final = json_examples(
    {
        "a box": {"context": _BOX},
        "an L, 20 mm from every side, straight and aslant": {
            "context": {"outline": L_EXAMPLE},
            "spacing": 0.01,
            "angles": [-0.4, 0.0, 0.4],
            "length": 0.02,
        },
        "an object by its descriptor": {"context": {"descriptor": "1a2b3c4a"}, "angles": [0.0]},
    }
)
GOALS: Final = json_examples(
    {
        "a box to a goal": {"context": _BOX, "object_pose": POSE_EXAMPLE, "goal": GOAL_EXAMPLE},
        "an L around an obstacle, within a workspace": {
            "context": {"outline": L_EXAMPLE},
            "object_pose": POSE_EXAMPLE,
            "goal": {"x": 0.65, "y": 0.2, "angle": 1.0},
            "position_tolerance": 0.02,
            "angle_tolerance": 0.3,
            "max_pushes": 8,
            "lengths": [0.03, 0.1],
            "workspace": WORKSPACE_EXAMPLE,
            "obstacles": [OBSTACLE_EXAMPLE],
            "clearance": 0.005,
            "time_s": 0.3,
            "seed": 7,
        },
        "an object by its descriptor": {
            "context": {"descriptor": "1a2b3c4a"},
            "object_pose": POSE_EXAMPLE,
            "goal": {"x": 0.45, "y": 0.1, "angle": 0.0},
        },
    }
)
KNOWN_PUSHES: Final = json_examples(
    {
        "three pushes of a box, in its frame": {
            "context": _BOX,
            "pushers": [[-0.07, 0.02, 0.0], [0.03, -0.05, 1.5708], [0.07, -0.01, 3.1416]],
            "lengths": 0.03,
            "outcomes": [[0.018, -0.001, -0.19], [0.001, 0.022, 0.24], [-0.022, 0.0, -0.11]],
        },
        "one push in the world, of an object whose centre of mass is known about": {
            "context": {"outline": L_EXAMPLE, "centre_of_mass": [-0.01, -0.012], "friction": 0.3},
            "object_poses": [[0.4, 0.1, 0.0]],
            "pushers": [[0.34, 0.08, 0.0]],
            "outcomes": [[0.438, 0.1, 0.12]],
            "seed": 7,
        },
    }
)
