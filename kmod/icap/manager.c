// SPDX-License-Identifier: GPL-2.0-only
/* The port as an FPGA manager, so that fpga-regions and overlays use it. */
#include <linux/completion.h>
#include <linux/scatterlist.h>

#include "cm_compat.h"
#include "cm_fpga_compat.h"
#include "icap.h"

#if IS_REACHABLE(CONFIG_FPGA)

static enum fpga_mgr_states manager_state(struct fpga_manager *manager)
{
	struct cm_icap *icap = manager->priv;

	if (!icap)
		return FPGA_MGR_STATE_UNKNOWN;
	return READ_ONCE(icap->status.state) == CM_ICAP_STATE_ERROR ? FPGA_MGR_STATE_WRITE_ERR :
								      FPGA_MGR_STATE_OPERATING;
}

static int manager_write_init(struct fpga_manager *manager, struct fpga_image_info *info,
			      const char *data, size_t count)
{
	struct cm_icap *icap = manager->priv;

	if (!icap) {
		dev_err(&manager->dev, "the port is gone; apply the region's overlay again\n");
		return -ENODEV;
	}
	if (!(info->flags & FPGA_MGR_PARTIAL_RECONFIG) && !icap->full) {
		dev_err(&manager->dev, "a full bitstream replaces the port it comes through\n");
		return -EINVAL;
	}
	return 0;
}

/**
 * struct manager_wait - the manager waits for its load
 * @over: completed at the end
 * @status: 0 or a negative errno
 */
struct manager_wait {
	struct completion over;
	int status;
};

static void manager_done(void *context, const struct cm_icap_completion *completion)
{
	struct manager_wait *wait = context;

	wait->status = completion->status;
	complete(&wait->over);
}

static int manager_load(struct cm_icap *icap, struct cm_buffer *buffer, size_t length)
{
	struct manager_wait wait;
	struct cm_icap_request request = {
		.buffer = buffer,
		.words.length = length,
		.done = manager_done,
		.context = &wait,
	};
	int ret;

	init_completion(&wait.over);
	ret = cm_icap_start(icap, &request);
	if (ret)
		return ret;
	/* bounded by the port's own timeout */
	wait_for_completion(&wait.over);
	return wait.status;
}

static int manager_write_sg(struct fpga_manager *manager, struct sg_table *table)
{
	struct cm_icap *icap = manager->priv;
	struct scatterlist *sg;
	struct cm_buffer *buffer;
	size_t length = 0;
	int i, ret;

	for_each_sgtable_sg(table, sg, i)
		length += sg->length;
	buffer = cm_buffer_alloc(icap->channel->alloc_dev, NULL, length);
	if (IS_ERR(buffer))
		return PTR_ERR(buffer);
	cm_buffer_sync_for_cpu(buffer, DMA_TO_DEVICE);
	sg_copy_to_buffer(table->sgl, table->orig_nents, buffer->cpu, length);
	cm_buffer_sync_for_device(buffer, DMA_TO_DEVICE);
	ret = manager_load(icap, buffer, length);
	cm_buffer_put(buffer);
	return ret;
}

/* the load has ended when write_sg returned */
static int manager_write_complete(struct fpga_manager *manager, struct fpga_image_info *info)
{
	return 0;
}

static const struct fpga_manager_ops manager_ops = {
	.state = manager_state,
	.write_init = manager_write_init,
	.write_sg = manager_write_sg,
	.write_complete = manager_write_complete,
};

/*
 * A region keeps the manager that it found first, and calls it when the port
 * is long unbound.  Who calls has this mutex (fpga_mgr_lock()).
 */
static void leave_manager(void *data)
{
	struct fpga_manager *manager = data;

	mutex_lock(&manager->ref_mutex);
	manager->priv = NULL;
	mutex_unlock(&manager->ref_mutex);
}

/**
 * cm_icap_manager_init() - register the manager
 * @icap: port
 *
 * Return: 0 or a negative errno.
 */
int cm_icap_manager_init(struct cm_icap *icap)
{
	icap->manager = cm_fpga_manager_register(icap->dev, "cm_icap", &manager_ops, icap);
	if (IS_ERR(icap->manager))
		return PTR_ERR(icap->manager);
	return devm_add_action_or_reset(icap->dev, leave_manager, icap->manager);
}
#else
int cm_icap_manager_init(struct cm_icap *icap)
{
	dev_info(icap->dev, "this kernel has no FPGA managers, only the node is there\n");
	return 0;
}
#endif
