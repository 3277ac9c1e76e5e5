// SPDX-License-Identifier: Apache-2.0

module fpga-cm

go 1.19

require google.golang.org/protobuf v1.28.1
