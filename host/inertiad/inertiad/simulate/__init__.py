# SPDX-License-Identifier: Apache-2.0
"""A trajectory and a body -> a run folder with the truth behind it."""
