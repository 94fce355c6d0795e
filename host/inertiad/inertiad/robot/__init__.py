# SPDX-License-Identifier: Apache-2.0
"""The description of a robot: robot.toml and its DBC files -> the configuration that the daemon and the core read."""
