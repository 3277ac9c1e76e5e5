// SPDX-License-Identifier: GPL-2.0-only
/* What is at the streams of an engine, and the engine at work. */
#include <linux/bitfield.h>
#include <linux/delay.h>
#include <linux/interrupt.h>
#include <linux/io.h>
#include <linux/irq.h>
#include <linux/sched.h>
#include <asm/byteorder.h>

#include "cm_icap.h"
#include "cm_icap_port.h"
#include "model.h"

#define BENCH_PACKETS 256
#define LINE_AGAIN_MS 1
#define PAD_WORD 0xFFFFFFFF

/**
 * axi_pl_sent() - a packet left MM2S
 * @engine: engine; its lock is held
 * @packet: packet, the stream's from now on
 */
void axi_pl_sent(struct axi_engine *engine, struct axi_packet *packet)
{
	list_add_tail(&packet->node, engine->pl == AXI_LOOP ? &engine->channels[1].stream :
							      &engine->channels[0].stream);
}

static u32 port_status(const struct axi_port *port)
{
	u32 word = CM_ICAP_SR_EOS | port->errors << CM_ICAP_SR_ERRORS_SHIFT;

	return port->errors & CM_ICAP_ERR_TIMEOUT ? word : word | CM_ICAP_SR_DONE;
}

static void port_end(struct axi_port *port)
{
	port->errors = cm_configport_end(&port->port) | port->inject;
	port->inject = 0;
	port->words = port->port.words;
	port->loads++;
	if (port->status)
		writel(port->force ?: port_status(port), port->status);
	port->force = 0;
	if (port->identity && !port->errors)
		writel(port->loaded, port->identity);
}

/* a load may come in several transfers; it begins with padding, and ends desynchronised */
static void port_take(struct axi_port *port, const struct axi_packet *packet)
{
	const __le32 *words = (const __le32 *)packet->data;
	size_t i, count = packet->length / sizeof(*words);

	if (!port->port.synced || !count || le32_to_cpu(words[0]) == PAD_WORD) {
		cm_configport_begin(&port->port);
		if (port->status)
			writel(0, port->status);
	}
	for (i = 0; i < count; i++)
		cm_configport_word(&port->port, le32_to_cpu(words[i]));
	if (!port->port.synced)
		port_end(port);
}

static void consume(struct axi_engine *engine)
{
	struct axi_channel *sent = &engine->channels[0];
	struct axi_packet *packet;
	u32 count = 0;

	if (engine->pl == AXI_PORT) {
		while ((packet = axi_packet_first(sent))) {
			port_take(&engine->port, packet);
			axi_packet_drop(packet);
		}
		return;
	}
	list_for_each_entry(packet, &sent->stream, node)
		count++;
	for (; count > BENCH_PACKETS; count--)
		axi_packet_drop(axi_packet_first(sent));
}

/**
 * axi_pl_camera() - the next frame
 * @work: of an engine
 *
 * Little-endian words that count up from the frame's number.  A camera does
 * not wait: a frame that nobody took is replaced.
 */
void axi_pl_camera(struct work_struct *work)
{
	struct axi_engine *engine = container_of(to_delayed_work(work), struct axi_engine, camera);
	struct axi_packet *packet = axi_packet_new(engine->frame_length, GFP_KERNEL);
	struct axi_channel *channel = &engine->channels[1];
	struct axi_packet *waiting;
	unsigned long flags;
	size_t i;

	for (i = 0; packet && i < engine->frame_length / sizeof(u32); i++)
		((__le32 *)packet->data)[i] = cpu_to_le32(engine->frames + i);
	engine->frames++;
	spin_lock_irqsave(&engine->lock, flags);
	waiting = axi_packet_first(channel);
	if (waiting && !waiting->taken)
		axi_packet_drop(waiting);
	if (packet)
		list_add_tail(&packet->node, &channel->stream);
	spin_unlock_irqrestore(&engine->lock, flags);
	axi_kick(engine);
	queue_delayed_work(system_unbound_wq, &engine->camera,
			   usecs_to_jiffies(engine->interval_us));
}

static bool step(struct axi_engine *engine)
{
	bool moved = false;
	unsigned long flags;
	int i;

	spin_lock_irqsave(&engine->lock, flags);
	if (engine->mcdma)
		moved = axi_mcdma_step(engine);
	for (i = 0; i < 2 && !engine->mcdma; i++)
		moved |= engine->vdma ? axi_vdma_step(&engine->channels[i]) :
					axi_dma_step(&engine->channels[i]);
	consume(engine);
	axi_mirror(engine);
	spin_unlock_irqrestore(&engine->lock, flags);
	return moved;
}

/* the delay timer, IRQDelay: its unit is too short to be told from none */
static void delay_timer(struct axi_channel *channel)
{
	u32 threshold = FIELD_GET(CR_THRESHOLD, channel->cr);

	if (!FIELD_GET(CR_DELAY, channel->cr) || channel->countdown == threshold)
		return;
	channel->countdown = threshold;
	axi_raise(channel, SR_DLY);
}

static unsigned int line_of(const struct axi_channel *channel)
{
	return channel->virq ?: irq_find_mapping(channel->engine->irqs, channel->irq);
}

/* the line is a level: it stays until the driver has cleared what raises it */
static bool drive_line(struct axi_engine *engine, struct axi_channel *channel, u32 irqs)
{
	unsigned long flags;
	unsigned int irq;
	bool high;

	spin_lock_irqsave(&engine->lock, flags);
	high = channel->sr & channel->cr & irqs;
	spin_unlock_irqrestore(&engine->lock, flags);
	irq = high ? line_of(channel) : 0;
	if (irq)
		irq_set_irqchip_state(irq, IRQCHIP_STATE_PENDING, true);
	return high;
}

static bool drive_lines(struct axi_engine *engine)
{
	bool high = false;
	int way, i;

	for (way = 0; way < 2 && !engine->mcdma; way++)
		high |= drive_line(engine, &engine->channels[way], SR_IRQS);
	for (i = 0; i < 2 * AXI_MC_CHANNELS && engine->mcdma; i++)
		high |= drive_line(engine, &engine->mc[i / AXI_MC_CHANNELS][i % AXI_MC_CHANNELS],
				   AXI_MC_IRQS);
	return high;
}

static void engine_work(struct work_struct *work)
{
	struct axi_engine *engine = container_of(to_delayed_work(work), struct axi_engine, work);
	unsigned long flags;

	do {
		if (engine->port.delay_us && engine->channels[0].armed)
			fsleep(engine->port.delay_us);
		drive_lines(engine);
		cond_resched();
	} while (step(engine));
	spin_lock_irqsave(&engine->lock, flags);
	delay_timer(&engine->channels[0]);
	delay_timer(&engine->channels[1]);
	spin_unlock_irqrestore(&engine->lock, flags);
	if (drive_lines(engine))
		queue_delayed_work(system_unbound_wq, &engine->work,
				   msecs_to_jiffies(LINE_AGAIN_MS));
}

/**
 * axi_kick() - something may be to be done
 * @engine: engine
 */
void axi_kick(struct axi_engine *engine)
{
	mod_delayed_work(system_unbound_wq, &engine->work, 0);
}

/**
 * axi_pl_init() - prepare the work
 * @engine: engine
 */
void axi_pl_init(struct axi_engine *engine)
{
	INIT_DELAYED_WORK(&engine->work, engine_work);
	INIT_DELAYED_WORK(&engine->camera, axi_pl_camera);
	if (engine->pl == AXI_CAMERA)
		queue_delayed_work(system_unbound_wq, &engine->camera, 0);
}
