# SPDX-License-Identifier: MIT
"""Random problems, solved by the public API and checked again from public operators alone.

python3 -m tests.sweep --kinds hertz pile --seeds 0:100 [--output FILE.jsonl]
"""
