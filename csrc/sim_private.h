/* SPDX-License-Identifier: Apache-2.0 */
/* Inside of the simulated fast path: shared by sim_fifo.c and sim_channel.c only. */
#ifndef CM_SIM_PRIVATE_H
#define CM_SIM_PRIVATE_H

#include "sim_fifo.h"

/* Serve one request, if one waits; false where it is not for us, and stays. */
bool sim_serve(struct cm_sim_channel *channel);

/* The transfer at the head has moved @length bytes. */
void sim_complete(struct cm_sim_channel *channel, uint64_t length, int32_t status);

/* Memory of the transfer at the head. */
uint8_t *sim_memory(const struct cm_sim_channel *channel);

static inline const struct cm_sim_transfer *sim_head(const struct cm_sim_channel *channel)
{
	return &channel->queue[channel->first];
}

#endif /* CM_SIM_PRIVATE_H */
