"""Hypothesis strategies for prediction requests: valid, nearly valid and odd bodies."""

import base64

from hypothesis import strategies as st

from service.schemas.shapes import L_EXAMPLE, OUTLINE_EXAMPLE
from service.schemas.supports import SUPPORT_EXAMPLE

VISUAL = base64.b64encode(bytes(1024)).decode()
PUSHER = {"x": -0.075, "y": 0.0, "angle": 0.0}

numbers = st.one_of(
    st.floats(-1.0, 1.0),
    st.integers(-2, 2),
    st.sampled_from([1e-7, 3e-5, 1e16, -0.0, 5e-324, 1e308, 10**30, True, None, "0.1"]),
)
poses = st.fixed_dictionaries({"x": numbers, "y": numbers, "angle": numbers})
pushers = st.fixed_dictionaries({"x": numbers, "y": numbers, "angle": numbers}, optional={"length": numbers})
contexts = st.one_of(
    st.none(),
    st.sampled_from(["1a2b3c4a", "4a4a4a4a", "9z", ""]).map(lambda text: {"descriptor": text}),
    st.lists(st.sampled_from([0, 1, 1.0, 2]), min_size=35, max_size=37).map(lambda bits: {"indicator": bits}),
    st.sampled_from([{"outline": OUTLINE_EXAMPLE}, {"outline": L_EXAMPLE, "friction": 0.3}, {"outline": [[0, 0]]}]),
    st.sampled_from([SUPPORT_EXAMPLE, {"pushers": [[0.1, 0.0, 9.0]] * 51, "outcomes": [[0.0, 0.0, 0.0]] * 51}, {}]).map(
        lambda support: {"support": support}
    ),
    st.lists(st.lists(numbers, min_size=3, max_size=3), max_size=3).map(
        lambda rows: {"support": {"pushers": rows, "outcomes": [[0.0, 0.0, 0.0]] * 2}}
    ),
    st.floats(0.01, 0.1).map(lambda side: {"outline": [[0.0, 0.0], [side, 0.0], [0.0, side]]}),
    st.sampled_from([{"visual": VISUAL}, {"visual": [[0.5] * 32] * 32}, {"visual": [[2]]}, {"visual": "?"}, {}]),
)
references = st.sampled_from(
    [
        None,
        None,
        "push-none",
        "push-shape",
        "push-anp",
        "push-indicator@1",
        "push-visual@champion",
        "push-failing",
        "nobody",
        "../x",
    ]
)
pushes = st.fixed_dictionaries(
    {"pusher": pushers}, optional={"context": contexts, "model": references, "object_pose": poses, "other": st.none()}
)

ODD = {
    "one key twice": b'{"pusher": {"x": 9, "x": 0, "y": 0, "angle": 0}}',
    "NaN": b'{"pusher": {"x": NaN, "y": 0, "angle": 0}}',
    "a surrogate": b'{"pusher": {"x": 0, "y": 0, "angle": 0}, "model": "\\ud800"}',
    "a byte order mark": b'\xef\xbb\xbf{"pusher": {"x": 0, "y": 0, "angle": 0}}',
    "a deep list": b'{"pusher": ' + b"[" * 5000,
    "deep and closed": b'{"pusher": ' + b"[" * 150 + b"]" * 150 + b"}",
    "a long number": b'{"pusher": {"x": ' + b"7" * 3000 + b', "y": 0, "angle": 0}}',
    "an escaped key": b'{"\\u0070usher": {"x": 0, "y": 0, "angle": 0}}',
    "a failing model": b'{"pusher": {"x": 0, "y": 0, "angle": 0}, "context": {"descriptor": "1a2b3c4a"}, '
    b'"model": "push-failing"}',
}
