# SPDX-License-Identifier: Apache-2.0
"""Comparisons with the truth or a recomputation: a recorded run, and the experiment of the source paper."""
