# SPDX-License-Identifier: Apache-2.0
"""Shapes that stand for a platform and its mass: hull of the attachments, ellipsoid of inertia.

The ellipsoid is the uniform one with the body's mass and inertia: semi-axes a_i^2 = 5/(2 m) (J_j + J_k - J_i) along
the principal axes. It shows the distribution of the mass, to scale with the platform.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from inertiad.base.body import Body
from inertiad.base.table import Array
from inertiad.robot.keys import inertia_matrix

FLAT: Final = 0.999
"""cosine between facets from which they are one"""


@dataclass(frozen=True)
class Hull:
    """Convex hull of the attachments."""

    triangles: list[list[int]]
    """indices of attachments"""
    edges: list[list[int]]
    """between facets that are not one plane"""


def hull(attachment: Array) -> Hull | None:
    """Hull of attachments [m, 3]; None: they are flat or fewer than four."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        found = ConvexHull(attachment)
    except (QhullError, ValueError):
        return None
    edges = []
    for a, neighbours in enumerate(found.neighbors):
        for b in neighbours[neighbours > a]:
            if found.equations[a, :3] @ found.equations[b, :3] < FLAT:
                edges.append(np.intersect1d(found.simplices[a], found.simplices[b]).tolist())
    return Hull(found.simplices.tolist(), edges)


def semi_axes(body: Body) -> tuple[Array, Array] | None:
    """Semi-axes [3] m and principal axes [3, 3] (columns, P axes); None: no body has this inertia."""
    J, axes = np.linalg.eigh(inertia_matrix(np.array(body.value[4:])))
    square = 2.5 / body.value[0] * (J.sum() - 2.0 * J)
    return (np.sqrt(square), axes) if body.value[0] > 0.0 and (square > 0.0).all() else None
