# SPDX-License-Identifier: Apache-2.0
"""`cm conformance`: plays a manager to test a client, and a client to test a manager."""
