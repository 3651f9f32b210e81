# SPDX-License-Identifier: Apache-2.0
"""Sequences that Cycles rendered: what their passes mean, whether they can be denoised, and the denoised files."""
