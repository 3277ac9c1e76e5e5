// SPDX-License-Identifier: Apache-2.0
/* Names of bitstreams below /lib/firmware; FOLDER is that of the configuration, defined before use. */
#define FIRMWARE_STRING(text) #text
#define FIRMWARE_PATH(folder, name) FIRMWARE_STRING(folder/name.bit.bin)
#define FIRMWARE(name) FIRMWARE_PATH(FOLDER, name)
