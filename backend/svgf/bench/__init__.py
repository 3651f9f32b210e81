# SPDX-License-Identifier: Apache-2.0
"""Measurements: what a frame costs, stage by stage."""
