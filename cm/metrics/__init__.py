# SPDX-License-Identifier: Apache-2.0
"""What is counted while the manager runs, as Prometheus' text, and the server that hands it out."""
