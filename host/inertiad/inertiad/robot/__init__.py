# SPDX-License-Identifier: Apache-2.0
"""A robot described: robot.toml and its DBC files -> the configuration that the daemon and the core read."""
