# SPDX-License-Identifier: Apache-2.0
"""Run folders, written and read: CAN logs, LCM logs, signals and tracker CSV -> aligned rows."""
