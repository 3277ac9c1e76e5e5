// SPDX-License-Identifier: Apache-2.0

// What `cm conformance` asks of this client, in lines of JSON (docs/conformance.md).
package main

import (
	"bytes"
	"context"
	"encoding/binary"
	"encoding/json"
	"errors"
	"fmt"
	"os"
	"strconv"
	"sync"
	"time"

	cm "fpga-cm"
	"fpga-cm/pb"
)

type object = map[string]any

type action struct {
	Do         string
	Names      []string
	Registers  registers
	Name       string
	Value      uint64
	Mask       uint64
	Mode       string
	Count      int
	Stream     string
	Generation uint64
	Data       []int
	Scope      string
	Guest      string
	Action     *action
	Actions    []action
}

// registers keep their order, which a map would lose.
type registers []*pb.RegWrite

func (r *registers) UnmarshalJSON(text []byte) error {
	tokens := json.NewDecoder(bytes.NewReader(text))
	tokens.UseNumber()
	if _, err := tokens.Token(); err != nil { // {
		return err
	}
	for tokens.More() {
		name, err := tokens.Token()
		if err != nil {
			return err
		}
		value, err := tokens.Token()
		if err != nil {
			return err
		}
		if number, err := strconv.ParseUint(fmt.Sprint(value), 10, 64); err == nil {
			*r = append(*r, cm.Value(name.(string), number))
		} else {
			*r = append(*r, cm.Named(name.(string), fmt.Sprint(value)))
		}
	}
	return nil
}

type asked struct {
	Connect struct{ Folder, Endpoint, Keys string }
	Timeout float64
	Do      []action
}

func main() {
	lines := json.NewDecoder(os.Stdin)
	for {
		var a asked
		if err := lines.Decode(&a); err != nil {
			return
		}
		json.NewEncoder(os.Stdout).Encode(object{"results": a.results()})
	}
}

func (a *asked) results() []object {
	results := make([]object, len(a.Do))
	if a.Connect.Keys != "" { // the standard library has no Curve25519 with XSalsa20
		for i := range results {
			results[i] = object{"unsupported": true}
		}
		return results
	}
	board, err := cm.Connect(a.Connect.Folder)
	for i := range results {
		if err != nil {
			results[i] = failed(err)
		} else {
			results[i] = a.done(board, &a.Do[i])
		}
	}
	if err == nil {
		board.Close()
	}
	return results
}

func (a *asked) done(board *cm.Board, do *action) object {
	ctx, cancel := context.WithTimeout(context.Background(), time.Duration(a.Timeout*float64(time.Second)))
	defer cancel()
	result, err := a.act(ctx, board, do)
	if err != nil {
		return failed(err)
	}
	return result
}

func failed(err error) object {
	var refusal *cm.Error
	if errors.As(err, &refusal) {
		return object{"error": refusal.Code}
	}
	if errors.Is(err, context.DeadlineExceeded) {
		return object{"error": "timeout"}
	}
	return object{"error": err.Error()}
}

func (a *asked) act(ctx context.Context, board *cm.Board, do *action) (object, error) {
	switch do.Do {
	case "status":
		status, err := board.Status(ctx)
		return object{"config": status.GetConfigName(), "mode": status.GetMode(), "busy": status.GetFpgaBusy()}, err
	case "read":
		return values(board.Read(ctx, do.Names...))
	case "write":
		return values(board.Write(ctx, do.Registers...))
	case "write_masked":
		return values(board.Write(ctx, cm.Masked(do.Name, do.Value, do.Mask)))
	case "mode":
		change, err := board.SetMode(ctx, do.Mode)
		return object{"seconds": change.GetSeconds()}, err
	case "statuses":
		return statuses(ctx, board, do)
	case "frame":
		frame, err := board.ReadFrame(ctx, do.Stream)
		return described(frame), err
	case "frames", "after":
		return frames(ctx, board, do)
	case "irqs":
		return irqs(ctx, board, do)
	case "send":
		data := make([]byte, len(do.Data))
		for i, value := range do.Data {
			data[i] = byte(value)
		}
		return object{}, board.Send(ctx, do.Stream, data)
	case "lease":
		lease, err := board.TakeLease(ctx, do.Scope, 0)
		return object{"id": lease.GetId()}, err
	case "as_guest":
		guest, err := cm.Connect(a.Connect.Folder, cm.AsGuest(do.Guest))
		if err != nil {
			return nil, err
		}
		defer guest.Close()
		return a.done(guest, do.Action), nil
	case "together":
		return a.together(board, do), nil
	}
	return object{"unsupported": true}, nil
}

func (a *asked) together(board *cm.Board, do *action) object {
	results := make([]object, len(do.Actions))
	var all sync.WaitGroup
	for i := range do.Actions {
		all.Add(1)
		go func(i int) {
			defer all.Done()
			results[i] = a.done(board, &do.Actions[i])
		}(i)
	}
	all.Wait()
	return object{"results": results}
}

func values(registers *pb.RegValues, err error) (object, error) {
	found := object{}
	for _, register := range registers.GetValues() {
		found[register.Name] = strconv.FormatUint(register.Value, 10)
	}
	return object{"values": found, "generation": registers.GetGeneration()}, err
}

func statuses(ctx context.Context, board *cm.Board, do *action) (object, error) {
	statuses, err := board.Statuses()
	if err != nil {
		return nil, err
	}
	defer statuses.Close()
	modes := []string{}
	for len(modes) < do.Count {
		status, err := statuses.Next(ctx)
		if err != nil {
			return nil, err
		}
		modes = append(modes, status.Mode)
	}
	return object{"modes": modes}, nil
}

func frames(ctx context.Context, board *cm.Board, do *action) (object, error) {
	frames, err := board.Frames(do.Stream)
	if err != nil {
		return nil, err
	}
	defer frames.Close()
	if do.Do == "after" {
		frame, err := frames.After(ctx, do.Generation)
		return described(frame), err
	}
	sequences := []uint64{}
	for len(sequences) < do.Count {
		frame, err := frames.Next(ctx)
		if err != nil {
			return nil, err
		}
		sequences = append(sequences, frame.Sequence)
	}
	return object{"sequences": sequences, "lost": frames.Lost}, nil
}

func irqs(ctx context.Context, board *cm.Board, do *action) (object, error) {
	interrupts, err := board.Interrupts(ctx, do.Name)
	if err != nil {
		return nil, err
	}
	defer interrupts.Close()
	counts := []uint64{}
	for len(counts) < do.Count {
		irq, err := interrupts.Next(ctx)
		if err != nil {
			return nil, err
		}
		counts = append(counts, irq.Count)
	}
	return object{"counts": counts}, nil
}

func described(frame cm.Frame) object {
	if frame.Frame == nil {
		return nil
	}
	data := make([]uint16, 0, len(frame.Data)) // the cases have no other types
	for rest := frame.Data; len(rest) > 0; {
		if frame.Dtype == "uint16" && len(rest) > 1 {
			data, rest = append(data, binary.LittleEndian.Uint16(rest)), rest[2:]
		} else {
			data, rest = append(data, uint16(rest[0])), rest[1:]
		}
	}
	return object{"sequence": frame.Sequence, "shape": frame.Shape, "dtype": frame.Dtype, "data": data}
}
