# SPDX-License-Identifier: Apache-2.0
"""Beside a running daemon: record, replay, watch and command."""
