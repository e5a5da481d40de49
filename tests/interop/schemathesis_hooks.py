"""What schemathesis sends as `application/octet-stream`: clouds, so that it comes further than the parser."""

import hypothesis.strategies as st
import numpy as np
import schemathesis


def cloud(seed):
    points = np.random.default_rng(seed).normal(size=(60, 3))
    return "".join(f"{x:.4f} {y:.4f} {z:.4f}\n" for x, y, z in points).encode()


schemathesis.openapi.media_type("application/octet-stream", st.integers(0, 1000).map(cloud))
