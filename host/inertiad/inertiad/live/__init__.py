# SPDX-License-Identifier: Apache-2.0
"""Tools beside a running daemon: record, replay, watch, command."""
