// SPDX-License-Identifier: Apache-2.0

// Package cm is a client of the FPGA configuration manager, written from docs/protocol.md.
package cm

//go:generate protoc -I ../../cm/wire --go_out=. --go_opt=module=fpga-cm,Mcm.proto=fpga-cm/pb cm.proto

import (
	"context"
	"errors"
	"fmt"
	"net"
	"os"
	"path/filepath"
	"strconv"
	"strings"
	"sync"
	"time"

	"fpga-cm/pb"
	"google.golang.org/protobuf/proto"
)

// Error is what the manager refused, or what this client met: "connection_lost", "closed", "key_refused", "bad_answer".
type Error struct {
	Code    string // stable; docs/reconfiguration.md lists those of the manager
	Message string
}

func (e *Error) Error() string { return e.Message + " (" + e.Code + ")" }

// Answer is a reply, and the payload frames behind it.
type Answer struct {
	Reply   *pb.Reply
	Payload [][]byte
}

type result struct {
	answer Answer
	err    error
}

// Board is a manager. Any number of goroutines may use it at a time.
type Board struct {
	pub, req string
	guest    string

	alive context.Context // until Close
	end   context.CancelFunc

	mu      sync.Mutex
	line    *line         // nil: lost, and connected again by the next request
	dialing chan struct{} // closed when that has ended; nil: nobody dials
	failed  error         // of the last one who dialed
	pending map[string]chan<- result
	last    uint64
	leases  []string
}

// line is a connection for requests. What is to be sent is handed to a goroutine: the manager may be slow to read.
type line struct {
	*peer
	out   chan [][]byte
	ended chan struct{}
}

// Option changes how Connect works.
type Option func(*Board)

// AsGuest lets a bridge ask in the name of somebody else (docs/security.md): requests only.
func AsGuest(name string) Option { return func(b *Board) { b.guest = name } }

// Connect to tcp://host[:port], to a runtime folder, or, without a place, to the manager of this machine.
func Connect(place string, options ...Option) (*Board, error) {
	b := &Board{pending: map[string]chan<- result{}}
	b.alive, b.end = context.WithCancel(context.Background())
	for _, option := range options {
		option(b)
	}
	var err error
	if b.pub, b.req, err = endpoints(place); err != nil {
		return nil, err
	}
	if err = b.connected(b.alive); err != nil {
		b.end()
	}
	return b, err
}

func endpoints(place string) (pub, req string, err error) {
	if rest, tcp := cutPrefix(place, "tcp://"); tcp {
		host, digits, err := net.SplitHostPort(rest)
		if err != nil {
			host, digits = strings.Trim(rest, "[]"), "5560"
		}
		port, err := strconv.ParseUint(digits, 10, 16)
		if err != nil || port > 65533 || host == "" {
			return "", "", fmt.Errorf("%s is not tcp://host[:port]; three ports in a row are used", place)
		}
		at := func(port uint64) string { return "tcp://" + net.JoinHostPort(host, strconv.FormatUint(port, 10)) }
		return at(port), at(port + 2), nil
	}
	folder, _ := cutPrefix(place, "ipc://")
	if folder == "" {
		folder = runtimeFolder()
	}
	return "ipc://" + filepath.Join(folder, "pub"), "ipc://" + filepath.Join(folder, "req"), nil
}

// As docs/cli.md has it.
func runtimeFolder() string {
	if chosen := os.Getenv("CM_RUNTIME_DIR"); chosen != "" {
		return chosen
	}
	user := os.Getenv("XDG_RUNTIME_DIR")
	if _, err := os.Stat("/run/cm/req"); err == nil || os.Getuid() == 0 || user == "" {
		return "/run/cm"
	}
	return filepath.Join(user, "cm")
}

func cutPrefix(text, prefix string) (string, bool) { // strings has it from Go 1.20 on
	return strings.TrimPrefix(text, prefix), strings.HasPrefix(text, prefix)
}

// connected waits as long as ctx lasts until there is a connection, which one of those who wait makes for all.
func (b *Board) connected(ctx context.Context) error {
	b.mu.Lock()
	if b.line != nil {
		b.mu.Unlock()
		return nil
	}
	dialing := b.dialing
	if dialing == nil {
		dialing = make(chan struct{})
		b.dialing = dialing
		go b.dial(dialing)
	}
	b.mu.Unlock()
	select {
	case <-dialing:
		b.mu.Lock()
		defer b.mu.Unlock()
		if b.line != nil {
			return nil
		}
		return b.failed
	case <-ctx.Done():
		return fmt.Errorf("no connection to %s: %w", b.req, ctx.Err())
	}
}

func (b *Board) dial(done chan struct{}) {
	p, err := dial(b.alive, b.req, "DEALER")
	b.mu.Lock()
	defer b.mu.Unlock()
	if b.alive.Err() != nil {
		if err == nil {
			p.conn.Close()
		}
		err = b.goneLocked()
	} else if err == nil {
		b.line = &line{p, make(chan [][]byte), make(chan struct{})}
		go b.receive(b.line)
		go b.send(b.line)
	}
	b.failed, b.dialing = err, nil
	close(done)
}

func (b *Board) send(l *line) {
	for {
		select {
		case frames := <-l.out:
			if l.write(frames) != nil {
				b.lose(l)
			}
		case <-l.ended:
			return
		}
	}
}

// receive hands replies to those who wait for them, until the connection ends.
func (b *Board) receive(l *line) {
	for {
		frames, err := l.read()
		if err != nil {
			b.lose(l)
			return
		}
		for i := 1; i+2 < len(frames); i++ { // what led here, an empty frame, the topic, the reply
			if len(frames[i]) == 0 {
				b.deliver(string(frames[0]), frames[i+2], frames[i+3:])
				break
			}
		}
	}
}

func (b *Board) deliver(number string, message []byte, payload [][]byte) {
	waiting := b.take(number)
	if waiting == nil {
		return // it comes too late
	}
	reply := &pb.Reply{}
	err := decoded(proto.Unmarshal(message, reply))
	if err == nil && !reply.Ok {
		err = &Error{reply.GetError().GetCode(), reply.GetError().GetMessage()}
	}
	waiting <- result{Answer{reply, payload}, err}
}

func (b *Board) take(number string) chan<- result {
	b.mu.Lock()
	defer b.mu.Unlock()
	waiting := b.pending[number]
	delete(b.pending, number)
	return waiting
}

// lose ends the waiting of all requests that went over that connection.
func (b *Board) lose(l *line) {
	l.conn.Close()
	b.mu.Lock()
	defer b.mu.Unlock()
	if b.line != l {
		return
	}
	b.line = nil
	close(l.ended)
	for number, waiting := range b.pending {
		waiting <- result{err: b.goneLocked()}
		delete(b.pending, number)
	}
}

func (b *Board) goneLocked() error {
	if b.alive.Err() != nil {
		return &Error{"closed", "the board was closed: Connect again"}
	}
	return &Error{"connection_lost", "the configuration manager at " + b.req + " went away"}
}

// Close ends all that waits. Leases end by their time, unless they were given back.
func (b *Board) Close() {
	b.end()
	b.mu.Lock()
	l := b.line
	b.mu.Unlock()
	if l != nil {
		b.lose(l)
	}
}

// Ask sends a request and waits for its reply as long as ctx lasts. A refusal is an *Error with the manager's code.
// When ctx ends first, the payload may still be on its way: do not change it afterwards.
func (b *Board) Ask(ctx context.Context, topic string, message proto.Message, payload ...[]byte) (Answer, error) {
	body, err := proto.Marshal(message)
	if err != nil {
		return Answer{}, err
	}
	came := make(chan result, 1) // so that nobody waits to deliver what nobody takes any more
	number, l, err := b.register(ctx, came)
	if err != nil {
		return Answer{}, err
	}
	frames := [][]byte{[]byte(number)}
	if b.guest != "" {
		frames = append(frames, []byte("for="+b.guest))
	}
	frames = append(append(frames, nil, []byte(topic), body), payload...)
	out := l.out
	for {
		select {
		case out <- frames:
			out = nil // once
		case r := <-came: // a loss of the connection too
			return r.answer, r.err
		case <-ctx.Done():
			b.take(number)
			return Answer{}, fmt.Errorf("no answer to %s from %s: %w", topic, b.req, ctx.Err())
		}
	}
}

func (b *Board) register(ctx context.Context, came chan<- result) (string, *line, error) {
	if err := b.connected(ctx); err != nil {
		return "", nil, err
	}
	b.mu.Lock()
	defer b.mu.Unlock()
	if b.line == nil {
		return "", nil, b.goneLocked()
	}
	b.last++
	number := strconv.FormatUint(b.last, 10)
	b.pending[number] = came
	return number, b.line, nil
}

// decoded is an error of reading what came.
func decoded(err error) error {
	if err == nil {
		return nil
	}
	return &Error{"bad_answer", "what the manager sent cannot be read: " + err.Error()}
}

// body of a reply, which may be another's.
func body[T any](it *T, err error) (*T, error) {
	if err == nil && it == nil {
		return nil, decoded(errors.New("the answer is to something else"))
	}
	return it, err
}

// Event is what the manager published on a topic.
type Event struct {
	Topic   string
	Message []byte
	Payload [][]byte
}

// Subscription is a connection of its own. Who reads too slowly loses what the manager cannot keep (docs/streams.md).
type Subscription struct {
	peer   *peer
	events chan Event
	done   chan struct{}
	end    sync.Once
	topics map[string]bool
}

// Subscribe to topics. What was published before the manager knows of it is lost: with "cm_status" as the last topic,
// the first status shows that it does.
func (b *Board) Subscribe(topics ...string) (*Subscription, error) {
	if b.guest != "" {
		return nil, errors.New("what is published is handed to the bridge, not to " + b.guest)
	}
	p, err := dial(b.alive, b.pub, "SUB")
	if err != nil {
		return nil, err
	}
	s := &Subscription{peer: p, events: make(chan Event, 8), done: make(chan struct{}), topics: map[string]bool{}}
	for _, topic := range topics {
		s.topics[topic] = true
		if err := p.subscribe(topic); err != nil {
			p.conn.Close()
			return nil, err
		}
	}
	go s.receive()
	return s, nil
}

func (s *Subscription) receive() {
	defer close(s.events)
	for {
		frames, err := s.peer.read()
		if err != nil {
			return
		}
		// subscriptions match by prefix: cm_stream/camera2 comes with cm_stream/camera
		if len(frames) < 2 || !s.topics[string(frames[0])] {
			continue
		}
		select {
		case s.events <- Event{string(frames[0]), frames[1], frames[2:]}:
		case <-s.done:
			return
		}
	}
}

// Next is the next event. When the manager has gone away, subscribe again.
func (s *Subscription) Next(ctx context.Context) (Event, error) {
	select {
	case event, open := <-s.events:
		if !open {
			return event, &Error{"connection_lost", "the configuration manager went away, or the subscription was closed"}
		}
		return event, nil
	case <-ctx.Done():
		return Event{}, fmt.Errorf("nothing was published: %w", ctx.Err())
	}
}

// Close ends it; twice is fine.
func (s *Subscription) Close() {
	s.end.Do(func() {
		close(s.done)
		s.peer.conn.Close()
	})
}

// remaining is how long ctx lasts, in seconds; a day if it has no end.
func remaining(ctx context.Context) float64 {
	deadline, has := ctx.Deadline()
	if !has {
		return (24 * time.Hour).Seconds()
	}
	if left := time.Until(deadline).Seconds(); left > 0.001 {
		return left
	}
	return 0.001 // 0 would mean a second
}
