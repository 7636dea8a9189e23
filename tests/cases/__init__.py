# SPDX-License-Identifier: MIT
"""Problems, meshes and laws that several tests take."""
