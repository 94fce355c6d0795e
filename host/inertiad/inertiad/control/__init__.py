# SPDX-License-Identifier: Apache-2.0
"""A controller that takes its parameters from the daemon, in closed loop with a simulated robot."""
