// SPDX-License-Identifier: Apache-2.0

package cm

import (
	"bufio"
	"bytes"
	"context"
	"encoding/binary"
	"fmt"
	"io"
	"net"
	"strings"
	"sync"
	"time"
)

// The part of ZMTP 3.1 (https://rfc.zeromq.org/spec/37/) that one connection of a client needs: the NULL mechanism,
// messages of several frames, subscriptions, and answers to heartbeats. ZeroMQ's sockets are many connections behind
// queues; a client of one manager needs neither.

const (
	flagMore    = 1
	flagLong    = 2
	flagCommand = 4

	greetingLength = 64
	longestMessage = 1<<30 + 1<<20 // bytes of all its frames: what claims to be longer is not a message
	mostFrames     = 4096          // of one message
	longestPing    = 2 + 16        // bytes
	atOnce         = 1 << 20       // bytes that are made room for before they come
	handshakeTime  = 10 * time.Second
)

// peer is a connection after its handshake. One goroutine may receive while others send.
type peer struct {
	conn     net.Conn
	in       *bufio.Reader
	sending  sync.Mutex
	commands bool // it is of version 3.1, where a subscription is a command
}

// dial connects to ipc://PATH or tcp://HOST:PORT as a socket of that type ("DEALER", "SUB"), while ctx lasts.
func dial(ctx context.Context, address, socket string) (*peer, error) {
	network, place, found := strings.Cut(address, "://")
	if !found || network != "ipc" && network != "tcp" {
		return nil, fmt.Errorf("%s is neither ipc://… nor tcp://…", address)
	}
	if network == "ipc" {
		network = "unix"
	}
	ctx, cancel := context.WithTimeout(ctx, handshakeTime)
	conn, err := (&net.Dialer{}).DialContext(ctx, network, place)
	if err != nil {
		cancel()
		return nil, err
	}
	ended := make(chan struct{})
	go func() { // an end of ctx ends the handshake
		<-ctx.Done()
		conn.SetDeadline(time.Unix(1, 0))
		close(ended)
	}()
	p := &peer{conn: conn, in: bufio.NewReaderSize(conn, 1<<16)}
	err = p.handshake(socket)
	late := ctx.Err()
	cancel()
	<-ended
	if late != nil {
		err = late
	}
	if err != nil {
		conn.Close()
		return nil, fmt.Errorf("%s: %w", address, err)
	}
	conn.SetDeadline(time.Time{})
	return p, nil
}

func (p *peer) handshake(socket string) error {
	ours := make([]byte, greetingLength) // signature, version, mechanism, as-server 0, filler
	ours[0], ours[8], ours[9], ours[10], ours[11] = 0xFF, 1, 0x7F, 3, 1
	copy(ours[12:32], "NULL")
	// libzmq answers a version with its mechanism, and hangs up, perhaps before that, on one that is not its own
	const version = 12
	if _, err := p.conn.Write(ours[:version]); err != nil {
		return err
	}
	theirs := make([]byte, greetingLength)
	if _, err := io.ReadFull(p.in, theirs); err != nil {
		return err
	}
	if theirs[0] != 0xFF || theirs[9] != 0x7F || theirs[10] < 3 {
		return fmt.Errorf("what answers there does not speak ZMTP 3")
	}
	p.commands = theirs[10] > 3 || theirs[11] >= 1
	if mechanism := string(bytes.TrimRight(theirs[12:32], "\x00")); mechanism != "NULL" {
		return &Error{"key_refused", "the manager asks for keys (" + mechanism + "), which this client does not have"}
	}
	if _, err := p.conn.Write(ours[version:]); err != nil {
		return err
	}
	return p.exchangeReady(socket)
}

func (p *peer) exchangeReady(socket string) error {
	ready := property(property([]byte("\x05READY"), "Socket-Type", socket), "Identity", "")
	if err := p.send(flagCommand, ready); err != nil {
		return err
	}
	flags, body, err := p.frame(atOnce)
	if err != nil {
		return err
	}
	switch name, data := command(body); {
	case flags&flagCommand != 0 && name == "READY":
		return nil
	case flags&flagCommand != 0 && name == "ERROR" && len(data) > 0:
		return &Error{"refused", "the manager refused the connection: " + string(data[1:])}
	}
	return fmt.Errorf("READY should come behind the greeting")
}

func property(to []byte, name, value string) []byte {
	to = append(append(to, byte(len(name))), name...)
	to = binary.BigEndian.AppendUint32(to, uint32(len(value)))
	return append(to, value...)
}

// command is a command's name, and what is behind it; both are empty if it is malformed.
func command(body []byte) (name string, data []byte) {
	if len(body) == 0 || len(body) < 1+int(body[0]) {
		return "", nil
	}
	return string(body[1 : 1+body[0]]), body[1+body[0]:]
}

// write sends one message, as long as the other side takes to read it.
func (p *peer) write(frames [][]byte) error {
	p.sending.Lock()
	defer p.sending.Unlock()
	return p.put(0, frames...)
}

// send is for one frame with flags of its own.
func (p *peer) send(flags byte, body []byte) error {
	p.sending.Lock()
	defer p.sending.Unlock()
	return p.put(flags, body)
}

func (p *peer) put(flags byte, frames ...[]byte) error {
	parts := make(net.Buffers, 0, 2*len(frames))
	for i, body := range frames {
		mine := flags
		if i < len(frames)-1 {
			mine |= flagMore
		}
		head := []byte{mine, byte(len(body))}
		if len(body) > 255 {
			head = binary.BigEndian.AppendUint64([]byte{mine | flagLong}, uint64(len(body)))
		}
		parts = append(parts, head, body)
	}
	_, err := parts.WriteTo(p.conn)
	return err
}

func (p *peer) subscribe(topic string) error {
	if p.commands {
		return p.send(flagCommand, append([]byte("\x09SUBSCRIBE"), topic...))
	}
	return p.send(0, append([]byte{1}, topic...))
}

// read is the next message; commands between messages are answered or, unless known, ignored.
func (p *peer) read() ([][]byte, error) {
	var frames [][]byte
	left := longestMessage
	for {
		flags, body, err := p.frame(left)
		if err != nil {
			return nil, err
		}
		if flags&flagCommand != 0 {
			name, data := command(body)
			if name == "PING" && len(data) >= 2 && len(data) <= longestPing { // a time to live, and what is to come back
				if err := p.send(flagCommand, append([]byte("\x04PONG"), data[2:]...)); err != nil {
					return nil, err
				}
			}
			continue
		}
		if frames = append(frames, body); flags&flagMore == 0 {
			return frames, nil
		}
		if left -= len(body); len(frames) == mostFrames {
			return nil, fmt.Errorf("a message of more than %d frames came", mostFrames)
		}
	}
}

// frame is the next one, of most bytes; room is made for more than a few as they come.
func (p *peer) frame(most int) (flags byte, body []byte, err error) {
	if flags, err = p.in.ReadByte(); err != nil {
		return 0, nil, err
	}
	size := make([]byte, 1, 8)
	if flags&flagLong != 0 {
		size = size[:8]
	}
	if _, err = io.ReadFull(p.in, size); err != nil {
		return 0, nil, err
	}
	var length uint64
	for _, digit := range size {
		length = length<<8 | uint64(digit)
	}
	if length > uint64(most) {
		return 0, nil, fmt.Errorf("a frame of %d bytes was announced", length)
	}
	if length <= atOnce {
		body = make([]byte, length)
		_, err = io.ReadFull(p.in, body)
		return flags, body, err
	}
	whole := bytes.NewBuffer(make([]byte, 0, atOnce))
	_, err = io.CopyN(whole, p.in, int64(length))
	return flags, whole.Bytes(), err
}
