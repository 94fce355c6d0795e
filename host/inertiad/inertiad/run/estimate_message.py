# SPDX-License-Identifier: Apache-2.0
"""ESTIMATE messages of every version, as the present one. The version is found by the message type's fingerprint."""

from typing import Final

from inertiad_lcm import estimate_t, estimate_v1_t, estimate_v2_t

_V1_BEFORE_FORCES: Final = (
    *(f"attitude_bias_{a}" for a in "xyz"),
    "world_yaw",
    *(f"acc_bias_{a}" for a in "xyz"),
    *(f"imu_alignment_{a}" for a in "xyz"),
    "position_delay",
)


def _v1_names(n: int) -> list[str]:
    """Names of version 1's n systematic parameters, which it gave by position."""
    n_cables = (n - len(_V1_BEFORE_FORCES)) // 2
    forces = [f"force_{kind}_{i + 1}" for kind in ("offset", "gain") for i in range(n_cables)]
    return [*_V1_BEFORE_FORCES, *forces][:n]


def _with_fields_of(old: estimate_v1_t | estimate_v2_t) -> estimate_t:
    new = estimate_t()
    for name in old.__slots__:
        setattr(new, name, getattr(old, name))
    return new


def _of_v1(old: estimate_v1_t) -> estimate_t:
    new = _with_fields_of(old)
    new.schema = 1
    new.systematic_name = _v1_names(old.n_systematic)
    new.verdict = estimate_t.UNKNOWN
    return new


def decode(data: bytes) -> estimate_t:
    """An ESTIMATE message of any version. ValueError: of none."""
    if data[:8] == estimate_v1_t._get_packed_fingerprint():
        return _of_v1(estimate_v1_t.decode(data))
    if data[:8] == estimate_v2_t._get_packed_fingerprint():
        return _with_fields_of(estimate_v2_t.decode(data))  # before provisional estimates
    return estimate_t.decode(data)
