# SPDX-License-Identifier: Apache-2.0
"""inertiad on the host: describe a robot, compile it for the daemon, simulate or import runs, watch the estimate."""
