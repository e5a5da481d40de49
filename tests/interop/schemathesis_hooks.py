"""What schemathesis cannot know of the description: what a cloud is, and that a request has one target."""

import hypothesis.strategies as st
import numpy as np
import schemathesis


def cloud(seed):
    points = np.random.default_rng(seed).normal(size=(60, 3))
    return "".join(f"{x:.4f} {y:.4f} {z:.4f}\n" for x, y, z in points).encode()


schemathesis.openapi.media_type("application/octet-stream", st.integers(0, 1000).map(cloud))


@schemathesis.hook
def map_case(context, case):
    """Of what shall be accepted, one target is left, and no rule for attributes that the cloud has not got."""
    valid = case.meta is not None and case.meta.generation.mode.is_positive
    if valid and case.operation.path in ("/upsample", "/jobs") and case.method == "POST":
        kept = ("seed", "keep_input", "source_fields")
        case.query = {"ratio": 2} | {name: value for name, value in (case.query or {}).items() if name in kept}
    if valid and case.headers is not None:
        # Nothing is done within a millionth of a second, and the answer, 504, is right.
        case.headers.pop("X-Request-Timeout", None)
    return case
