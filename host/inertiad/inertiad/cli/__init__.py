# SPDX-License-Identifier: Apache-2.0
"""inertiactl: the command line."""
