// SPDX-License-Identifier: Apache-2.0

package cm

import (
	"context"
	"crypto/rand"
	"encoding/hex"
	"fmt"
	"strings"

	"fpga-cm/pb"
	"google.golang.org/protobuf/proto"
)

// Status of the board.
func (b *Board) Status(ctx context.Context) (*pb.Status, error) {
	answer, err := b.Ask(ctx, "cm_status", &pb.ReadStatus{})
	return body(answer.Reply.GetStatus(), err)
}

// Load a configuration (empty: the loaded one) in a mode (empty: its default mode), and wait until the board is there.
func (b *Board) Load(ctx context.Context, config, mode string) (*pb.Change, error) {
	answer, err := b.Ask(ctx, "cm_write_config", &pb.WriteConfig{ConfigName: config, Mode: mode, Lease: b.held()})
	return body(answer.Reply.GetChange(), err)
}

// SetMode of the loaded configuration.
func (b *Board) SetMode(ctx context.Context, mode string) (*pb.Change, error) {
	return b.Load(ctx, "", mode)
}

// Read registers and fields ("led.red"); none means all.
func (b *Board) Read(ctx context.Context, names ...string) (*pb.RegValues, error) {
	answer, err := b.Ask(ctx, "cm_read_reg", &pb.ReadReg{Names: names})
	return body(answer.Reply.GetRegisters(), err)
}

// Value for a register or field.
func Value(name string, value uint64) *pb.RegWrite { return &pb.RegWrite{Name: name, Value: value} }

// Named is a field's value by its name.
func Named(name, value string) *pb.RegWrite { return &pb.RegWrite{Name: name, Named: value} }

// Masked is a value of which only the bits of the mask are written.
func Masked(name string, value, mask uint64) *pb.RegWrite {
	return &pb.RegWrite{Name: name, Value: value, HasMask: &pb.RegWrite_Mask{Mask: mask}}
}

// Write registers in this order; all are checked before the first is written.
func (b *Board) Write(ctx context.Context, writes ...*pb.RegWrite) (*pb.RegValues, error) {
	answer, err := b.Ask(ctx, "cm_write_reg", &pb.WriteReg{Writes: writes, Lease: b.held()})
	return body(answer.Reply.GetRegisters(), err)
}

// Frame of a stream; Data lies as in memory: elements of Dtype, little-endian, in Shape.
type Frame struct {
	*pb.Frame
	Data []byte
}

func frame(info *pb.Frame, payload [][]byte, err error) (Frame, error) {
	info, err = body(info, err)
	if err == nil && (len(payload) == 0 || info.Length != uint64(len(payload[0]))) {
		err = decoded(fmt.Errorf("frame %d of %s has not the %d bytes that it claims", info.Sequence, info.Stream, info.Length))
	}
	if err != nil {
		return Frame{}, err
	}
	return Frame{info, payload[0]}, nil
}

// ReadFrame is the next frame of a stream from now on.
func (b *Board) ReadFrame(ctx context.Context, stream string) (Frame, error) {
	answer, err := b.Ask(ctx, "cm_read_data", &pb.ReadData{Stream: stream, Timeout: remaining(ctx)})
	return frame(answer.Reply.GetFrame(), answer.Payload, err)
}

// part is what one message carries of longer data: the manager takes 8 MiB.
const part = 4 << 20

// Send data to a stream, and wait until the hardware has taken it.
func (b *Board) Send(ctx context.Context, stream string, data []byte) error {
	request := &pb.WriteData{Stream: stream, Lease: b.held()}
	if len(data) <= part {
		_, err := b.Ask(ctx, "cm_write_data", request, data)
		return err
	}
	id := make([]byte, 16)
	if _, err := rand.Read(id); err != nil {
		return err
	}
	request.Upload = hex.EncodeToString(id)
	for offset := 0; offset < len(data); offset += part {
		end := offset + part
		if end > len(data) {
			end = len(data)
		}
		upload := &pb.Upload{Id: request.Upload, Length: uint64(len(data)), Offset: uint64(offset)}
		if _, err := b.Ask(ctx, "cm_upload", upload, data[offset:end]); err != nil {
			return err
		}
	}
	_, err := b.Ask(ctx, "cm_write_data", request)
	return err
}

// TakeLease of a scope ("region:prr0"), so that others are refused until it ends; our own requests pass.
func (b *Board) TakeLease(ctx context.Context, scope string, seconds float64) (*pb.Lease, error) {
	answer, err := b.Ask(ctx, "cm_lease", &pb.Lease{Scope: scope, Exclusive: true, Seconds: seconds})
	lease, err := body(answer.Reply.GetLease(), err)
	if err == nil {
		b.mu.Lock()
		b.leases = append(b.leases, lease.GetId())
		b.mu.Unlock()
	}
	return lease, err
}

// RenewLease from now on.
func (b *Board) RenewLease(ctx context.Context, id string, seconds float64) error {
	_, err := b.Ask(ctx, "cm_lease", &pb.Lease{Id: id, Seconds: seconds})
	return err
}

// ReleaseLease gives it back.
func (b *Board) ReleaseLease(ctx context.Context, id string) error {
	b.mu.Lock()
	for i, held := range b.leases {
		if held == id {
			b.leases = append(b.leases[:i:i], b.leases[i+1:]...)
			break
		}
	}
	b.mu.Unlock()
	_, err := b.Ask(ctx, "cm_lease", &pb.Lease{Id: id, Release: true})
	return err
}

func (b *Board) held() string {
	b.mu.Lock()
	defer b.mu.Unlock()
	return strings.Join(b.leases, ",")
}

// Frames are those of one stream as they are published.
type Frames struct {
	*Subscription
	Lost uint64 // between the frames that came
	last *pb.Frame
}

// Frames of a stream, which runs while somebody listens.
func (b *Board) Frames(stream string) (*Frames, error) {
	s, err := b.Subscribe("cm_stream/" + stream)
	return &Frames{Subscription: s}, err
}

// Next frame. A sequence that begins again is that of a stream that was opened again, and no loss.
func (f *Frames) Next(ctx context.Context) (Frame, error) {
	event, err := f.Subscription.Next(ctx)
	if err != nil {
		return Frame{}, err
	}
	info := &pb.Frame{}
	if err := decoded(proto.Unmarshal(event.Message, info)); err != nil {
		return Frame{}, err
	}
	if f.last != nil && info.Sequence > f.last.Sequence {
		f.Lost += info.Sequence - f.last.Sequence - 1
	}
	f.last = info
	return frame(info, event.Payload, nil)
}

// After is the first frame that began after the write (or change) of that generation.
func (f *Frames) After(ctx context.Context, generation uint64) (Frame, error) {
	for {
		if next, err := f.Next(ctx); err != nil || next.Generation >= generation {
			return next, err
		}
	}
}

// Statuses subscribes to the status: the present one comes at once.
func (b *Board) Statuses() (*Statuses, error) {
	s, err := b.Subscribe("cm_status")
	return &Statuses{s}, err
}

// Statuses are complete, each of them.
type Statuses struct{ *Subscription }

// Next status.
func (s *Statuses) Next(ctx context.Context) (*pb.Status, error) {
	event, err := s.Subscription.Next(ctx)
	if err != nil {
		return nil, err
	}
	status := &pb.Status{}
	return status, decoded(proto.Unmarshal(event.Message, status))
}

// Interrupts are those of one name.
type Interrupts struct {
	*Subscription
	name string
}

// Interrupts of that name from now on: when this returns, the manager knows of the subscription.
func (b *Board) Interrupts(ctx context.Context, name string) (*Interrupts, error) {
	s, err := b.Subscribe("cm_irq", "cm_status")
	if err != nil {
		return nil, err
	}
	for {
		event, err := s.Next(ctx)
		if err != nil {
			s.Close()
			return nil, err
		}
		if event.Topic == "cm_status" {
			return &Interrupts{s, name}, nil
		}
	}
}

// Next interrupt.
func (i *Interrupts) Next(ctx context.Context) (*pb.Irq, error) {
	for {
		event, err := i.Subscription.Next(ctx)
		if err != nil {
			return nil, err
		}
		irq := &pb.Irq{}
		if event.Topic != "cm_irq" {
			continue
		}
		if err := decoded(proto.Unmarshal(event.Message, irq)); err != nil || irq.Name == i.name {
			return irq, err
		}
	}
}
