// SPDX-License-Identifier: Apache-2.0
`ifndef REGISTER_BITS
`define REGISTER_BITS 6
`endif
