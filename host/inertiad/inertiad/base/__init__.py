# SPDX-License-Identifier: Apache-2.0
"""Names, units, tables and messages that every other folder uses; independent of any robot."""
