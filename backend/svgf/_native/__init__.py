# SPDX-License-Identifier: Apache-2.0
"""The native modules cpu, cpu_avx2 and cuda, of which each build has those that it could compile (backend/native)."""
