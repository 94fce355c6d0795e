# SPDX-License-Identifier: Apache-2.0
"""Runs -> the body, the systematic errors of the sensors, their uncertainty, and mistakes in the set-up."""
