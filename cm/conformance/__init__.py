# SPDX-License-Identifier: Apache-2.0
"""`cm conformance`: a manager that is played to a client, and a client that is played to a manager."""
