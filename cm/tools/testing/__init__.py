# SPDX-License-Identifier: Apache-2.0
"""A pytest plugin: a manager on a simulated board as a fixture, for tests of your own application and your own RTL.

It is found by pytest where the package is installed. Nothing of the package is imported until a fixture is used.
"""
