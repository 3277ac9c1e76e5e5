# SPDX-License-Identifier: Apache-2.0
"""The build tool, `cm build`: from HDL and a build schema to projects, bitstreams, overlays and runtime schemas.

In: sources of modules, ``build.yaml``, what a flow produced. Out: files, each from one template; problems, each with
its line. It must not know the manager, its server or its clients; their runtime schema is all that they share.
"""
