# SPDX-License-Identifier: Apache-2.0
"""From a state and a goal to steps: data; touches nothing."""
