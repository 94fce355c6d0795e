# SPDX-License-Identifier: Apache-2.0
"""Runs and identified bodies to and from the files of other tools."""
