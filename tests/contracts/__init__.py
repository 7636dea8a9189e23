# SPDX-License-Identifier: MIT
"""What all objects of a kind pass, those of users too."""
