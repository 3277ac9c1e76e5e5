// SPDX-License-Identifier: Apache-2.0
/*
 * A client of the configuration manager in C: libzmq and protobuf-c, nothing else.
 *
 *   protoc-c --c_out=. cm.proto
 *   cc -o client client.c cm.pb-c.c $(pkg-config --cflags --libs libzmq libprotobuf-c)
 *   ./client /run/cm edge_detection
 *
 * Goes to a mode, sets a register, reads it back, and takes one camera frame.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zmq.h>

#include "cm.pb-c.h"

#define TIMEOUT_MS 20000

static void die(const char *what)
{
	fprintf(stderr, "%s: %s\n", what, zmq_strerror(zmq_errno()));
	exit(1);
}

static void *open_socket(void *context, int type, const char *folder, const char *name)
{
	int timeout = TIMEOUT_MS, linger = 0;
	char address[256];
	void *socket = zmq_socket(context, type);

	if (!socket)
		die("zmq_socket");
	snprintf(address, sizeof(address), "ipc://%s/%s", folder, name);
	zmq_setsockopt(socket, ZMQ_RCVTIMEO, &timeout, sizeof(timeout));
	zmq_setsockopt(socket, ZMQ_LINGER, &linger, sizeof(linger));
	if (zmq_connect(socket, address))
		die(address);
	return socket;
}

/* Receive one message: its first @count frames into @frames, the rest is dropped.  Returns how many came. */
static int receive(void *socket, zmq_msg_t *frames, int count)
{
	int got = 0, more = 1;
	size_t size = sizeof(more);

	while (more) {
		zmq_msg_t *frame = &frames[got < count ? got : count - 1];

		if (got >= count)
			zmq_msg_close(frame);
		zmq_msg_init(frame);
		if (zmq_msg_recv(frame, socket, 0) < 0)
			die("nothing came from the manager");
		zmq_getsockopt(socket, ZMQ_RCVMORE, &more, &size);
		got++;
	}
	return got;
}

/* Send [topic][message] and unpack the Reply; the caller frees it.  Ends the program on an error reply. */
static Cm__Reply *ask(void *req, const char *topic, const void *message, size_t length)
{
	zmq_msg_t frames[3];
	Cm__Reply *reply;
	int count;

	if (zmq_send(req, topic, strlen(topic), ZMQ_SNDMORE) < 0 || zmq_send(req, message, length, 0) < 0)
		die("zmq_send");
	count = receive(req, frames, 3);
	if (count < 2)
		die("a reply has at least two frames");
	reply = cm__reply__unpack(NULL, zmq_msg_size(&frames[1]), zmq_msg_data(&frames[1]));
	for (int i = 0; i < count && i < 3; i++)
		zmq_msg_close(&frames[i]);
	if (!reply)
		die("the reply is not a Reply message");
	if (!reply->ok) {
		fprintf(stderr, "%s: %s: %s\n", topic, reply->error->code, reply->error->message);
		exit(1);
	}
	return reply;
}

static void go_to_mode(void *req, char *mode)
{
	Cm__WriteConfig message = CM__WRITE_CONFIG__INIT;
	uint8_t buffer[256];
	Cm__Reply *reply;

	message.mode = mode; /* a mode, or the module that one mode consists of */
	reply = ask(req, "cm_write_config", buffer, cm__write_config__pack(&message, buffer));
	printf("change %lu took %.1f ms\n", (unsigned long)reply->change->number, reply->change->seconds * 1e3);
	cm__reply__free_unpacked(reply, NULL);
}

static void write_focus(void *req, uint64_t value)
{
	Cm__RegWrite write = CM__REG_WRITE__INIT, *writes[] = { &write };
	Cm__WriteReg message = CM__WRITE_REG__INIT;
	uint8_t buffer[64];
	Cm__Reply *reply;

	write.name = "focus";
	write.value = value;
	message.writes = writes;
	message.n_writes = 1;
	reply = ask(req, "cm_write_reg", buffer, cm__write_reg__pack(&message, buffer));
	printf("focus = %lu\n", (unsigned long)reply->registers->values[0]->value);
	cm__reply__free_unpacked(reply, NULL);
}

static void take_frame(void *context, const char *folder)
{
	void *sub = open_socket(context, ZMQ_SUB, folder, "pub");
	zmq_msg_t frames[3];
	Cm__Frame *frame;

	zmq_setsockopt(sub, ZMQ_SUBSCRIBE, "cm_read_data", strlen("cm_read_data"));
	if (receive(sub, frames, 3) != 3)
		die("a frame comes as [topic][Frame][payload]");
	frame = cm__frame__unpack(NULL, zmq_msg_size(&frames[1]), zmq_msg_data(&frames[1]));
	if (!frame)
		die("no Frame message");
	printf("frame of %s: %ux%u %s, %zu bytes, made in %s\n", frame->stream, frame->shape[0], frame->shape[1],
	       frame->dtype, zmq_msg_size(&frames[2]), frame->mode);
	cm__frame__free_unpacked(frame, NULL);
	for (int i = 0; i < 3; i++)
		zmq_msg_close(&frames[i]);
	zmq_close(sub);
}

int main(int argc, char **argv)
{
	void *context, *req;

	if (argc != 3) {
		fprintf(stderr, "usage: %s RUNTIME_DIR MODE\n", argv[0]);
		return 2;
	}
	context = zmq_ctx_new();
	req = open_socket(context, ZMQ_REQ, argv[1], "req");
	go_to_mode(req, argv[2]);
	write_focus(req, 2);
	take_frame(context, argv[1]);
	zmq_close(req);
	zmq_ctx_term(context);
	return 0;
}
