# SPDX-License-Identifier: Apache-2.0
"""Image files: OpenEXR in and out, PNG out; and the one way in which svgf writes any file."""
