// SPDX-License-Identifier: Apache-2.0
/* The generation of registers under which a frame began: times of writes compared with the end of the last frame. */
#include "clock.h"
#include "plane_private.h"

void cm_plane_wrote(struct cm_plane *plane, uint64_t generation)
{
	struct generations *known = &plane->generations;

	pthread_mutex_lock(&known->lock);
	if (generation > known->latest) {
		known->recent[known->count++ % GENERATIONS_KEPT] = (struct generation){
			.number = generation,
			.done_ns = (uint64_t)cm_clock_ns(),
		};
		known->latest = generation;
	}
	pthread_mutex_unlock(&known->lock);
}

/*
 * What was written since is left out, however soon after: its frame may have begun before. Where more
 * writes came since than are kept, the answer is an older generation than the true one, never a newer.
 */
uint64_t generation_at(struct cm_plane *plane, uint64_t at_ns, uint64_t before)
{
	struct generations *known = &plane->generations;
	uint64_t found = before;
	uint64_t kept;

	pthread_mutex_lock(&known->lock);
	kept = known->count < GENERATIONS_KEPT ? known->count : GENERATIONS_KEPT;
	for (uint64_t i = 1; i <= kept; i++) {
		const struct generation *entry =
			&known->recent[(known->count - i) % GENERATIONS_KEPT];

		if (entry->done_ns > at_ns)
			continue;
		if (entry->number > before)
			found = entry->number;
		break;
	}
	pthread_mutex_unlock(&known->lock);
	return found;
}
