# SPDX-License-Identifier: Apache-2.0
"""slam-gateway-experiment: measures a mesh through the daemon's trace, draws the figures of the thesis's chapter 8, compares."""
