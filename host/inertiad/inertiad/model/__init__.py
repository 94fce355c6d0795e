# SPDX-License-Identifier: Apache-2.0
"""Rigid body, cables and winches: the motion, the wrench it needs, and random errors over time."""
