// SPDX-License-Identifier: Apache-2.0

package cm

import (
	"bufio"
	"bytes"
	"context"
	"encoding/json"
	"errors"
	"os"
	"os/exec"
	"path/filepath"
	"strings"
	"testing"
	"time"
)

// manager serves a simulated board, over ipc and, without keys, over TCP.
type manager struct {
	runtime, tcp string
	process      *exec.Cmd
}

func start(t *testing.T, arguments ...string) *manager {
	t.Helper()
	folder := t.TempDir()
	m := &manager{runtime: filepath.Join(folder, "run")}
	words := append(strings.Fields(os.Getenv("CM")), "serve", "--sim", "--runtime-dir", m.runtime,
		"--state-dir", filepath.Join(folder, "state"), "--listen", "tcp://127.0.0.1:0")
	words = append(words, arguments...)
	m.process = exec.Command(words[0], words[1:]...)
	said, err := m.process.StderrPipe()
	must(t, err)
	must(t, m.process.Start())
	t.Cleanup(func() {
		m.process.Process.Signal(os.Interrupt)
		m.process.Wait()
	})
	lines := bufio.NewScanner(said)
	for lines.Scan() && !strings.Contains(lines.Text(), "ready at") {
	}
	go func() { // a full pipe would hold it up
		for lines.Scan() {
		}
	}()
	text, err := os.ReadFile(filepath.Join(m.runtime, "endpoints.json"))
	must(t, err)
	var told struct{ Tcp []struct{ Pub string } }
	must(t, json.Unmarshal(text, &told))
	m.tcp = told.Tcp[0].Pub
	return m
}

func must(t *testing.T, err error) {
	t.Helper()
	if err != nil {
		t.Fatal(err)
	}
}

func code(err error) string {
	var refusal *Error
	if errors.As(err, &refusal) {
		return refusal.Code
	}
	return ""
}

func patience(t *testing.T) context.Context {
	ctx, cancel := context.WithTimeout(context.Background(), 2*time.Minute)
	t.Cleanup(cancel)
	return ctx
}

func connected(t *testing.T, place string, options ...Option) *Board {
	t.Helper()
	board, err := Connect(place, options...)
	must(t, err)
	t.Cleanup(board.Close)
	return board
}

func TestTour(t *testing.T) {
	m := start(t, "--insecure")
	for name, place := range map[string]string{"ipc": m.runtime, "tcp": m.tcp} {
		place := place
		t.Run(name, func(t *testing.T) {
			board := connected(t, place)
			_, err := board.Load(patience(t), "camera", "default")
			must(t, err)
			t.Run("the first frame after a write is one that began after it", func(t *testing.T) { writeAndSee(t, board) })
			t.Run("what is written comes back through the loop", func(t *testing.T) { loop(t, board) })
			t.Run("interrupts and statuses are told", func(t *testing.T) { told(t, board) })
			t.Run("what is held is held against others", func(t *testing.T) { hold(t, board, connected(t, place)) })
			t.Run("refusals have their codes", func(t *testing.T) {
				_, err := board.SetMode(patience(t), "no such mode")
				if code(err) != "unknown_mode" {
					t.Fatalf("unknown_mode is wanted, %v came", err)
				}
			})
		})
	}
}

func writeAndSee(t *testing.T, board *Board) {
	frames, err := board.Frames("camera")
	must(t, err)
	defer frames.Close()
	written, err := board.Write(patience(t), Value("focus", 12), Named("led.blink", "fast"))
	must(t, err)
	frame, err := frames.After(patience(t), written.Generation)
	must(t, err)
	if frame.Generation < written.Generation || len(frame.Data) != 480*640 {
		t.Fatalf("a frame of generation %d and later is wanted, %v came", written.Generation, frame.Frame)
	}
	read, err := board.Read(patience(t), "led.blink", "focus")
	must(t, err)
	if read.Values[0].Value != 2 || read.Values[1].Value != 12 {
		t.Fatal(read)
	}
}

func loop(t *testing.T, board *Board) {
	_, err := board.SetMode(patience(t), "loopback")
	must(t, err)
	picture := bytes.Repeat([]byte{1, 2, 3, 250, 251}, 480*640/5)
	back, failed := make(chan Frame, 1), make(chan error, 1)
	go func() {
		frame, err := board.ReadFrame(patience(t), "from_pl")
		failed <- err
		back <- frame
	}()
	statuses, err := board.Statuses()
	must(t, err)
	defer statuses.Close()
	for open := false; !open; {
		status, err := statuses.Next(patience(t))
		must(t, err)
		for _, stream := range status.Streams {
			open = open || stream.Name == "from_pl" && stream.Open
		}
	}
	must(t, board.Send(patience(t), "to_pl", picture))
	must(t, <-failed)
	if frame := <-back; !bytes.Equal(frame.Data, picture) {
		t.Fatalf("other bytes came back: %v", frame.Frame)
	}
	_, err = board.SetMode(patience(t), "default")
	must(t, err)
}

func told(t *testing.T, board *Board) {
	interrupts, err := board.Interrupts(patience(t), "frame_done")
	must(t, err)
	defer interrupts.Close()
	frames, err := board.Frames("camera") // the camera runs while somebody looks
	must(t, err)
	defer frames.Close()
	irq, err := interrupts.Next(patience(t))
	must(t, err)
	status, err := board.Status(patience(t))
	must(t, err)
	if irq.Count == 0 || status.ConfigName != "camera" || status.Mode != "default" {
		t.Fatal(irq, status)
	}
}

func hold(t *testing.T, board, other *Board) {
	lease, err := board.TakeLease(patience(t), "region:prr0", 0)
	must(t, err)
	_, err = board.SetMode(patience(t), "edge_detection")
	must(t, err)
	if _, err := other.SetMode(patience(t), "default"); code(err) != "held_by" {
		t.Fatalf("held_by is wanted, %v came", err)
	}
	must(t, board.RenewLease(patience(t), lease.Id, 60))
	must(t, board.ReleaseLease(patience(t), lease.Id))
	_, err = other.SetMode(patience(t), "default")
	must(t, err)
}

func TestAManagerThatDiesEndsTheWaitingAtOnce(t *testing.T) {
	m := start(t, "--insecure")
	board := connected(t, m.runtime)
	statuses, err := board.Statuses()
	must(t, err)
	_, err = statuses.Next(patience(t))
	must(t, err)
	_, err = board.Load(patience(t), "camera", "loopback")
	must(t, err)
	ended := make(chan error, 1)
	go func() {
		_, err := board.ReadFrame(patience(t), "from_pl")
		ended <- err
	}()
	for waiting := false; !waiting; {
		status, err := statuses.Next(patience(t))
		must(t, err)
		for _, stream := range status.Streams {
			waiting = waiting || stream.Name == "from_pl" && stream.Open
		}
	}
	m.process.Process.Kill()
	if err := <-ended; code(err) != "connection_lost" {
		t.Fatalf("connection_lost is wanted, %v came", err)
	}
	for err == nil { // what was on its way comes first
		_, err = statuses.Next(patience(t))
	}
	if code(err) != "connection_lost" {
		t.Fatalf("connection_lost is wanted, %v came", err)
	}
}

func TestATimeOutIsTheContextsAndAClosedBoardSaysSo(t *testing.T) {
	board := connected(t, start(t, "--insecure").runtime)
	frames, err := board.Frames("nothing")
	must(t, err)
	short, cancel := context.WithTimeout(context.Background(), 50*time.Millisecond)
	defer cancel()
	if _, err := frames.Next(short); !errors.Is(err, context.DeadlineExceeded) {
		t.Fatal(err)
	}
	if _, err := board.Status(short); !errors.Is(err, context.DeadlineExceeded) {
		t.Fatal(err)
	}
	board.Close()
	if _, err := board.Status(patience(t)); code(err) != "closed" {
		t.Fatalf("closed is wanted, %v came", err)
	}
}

func TestAManagerThatAsksForKeysIsToldApart(t *testing.T) {
	folder := t.TempDir()
	words := append(strings.Fields(os.Getenv("CM")), "keygen", folder, "robot")
	must(t, exec.Command(words[0], words[1:]...).Run())
	m := start(t, "--keys", filepath.Join(folder, "server.key"))
	if _, err := Connect(m.tcp); code(err) != "key_refused" {
		t.Fatalf("key_refused is wanted, %v came", err)
	}
}

func TestLongDataGoesInParts(t *testing.T) {
	board := connected(t, start(t, "--insecure").runtime)
	_, err := board.Load(patience(t), "camera", "loopback")
	must(t, err)
	// more than a frame of the loop: the manager has taken the parts when it refuses the whole
	err = board.Send(patience(t), "to_pl", make([]byte, 9<<20))
	if code(err) == "" || code(err) == "connection_lost" {
		t.Fatalf("a refusal of the manager is wanted, %v came", err)
	}
	t.Log(err)
}

func TestPlacesBecomeEndpoints(t *testing.T) {
	for place, want := range map[string][2]string{
		"tcp://kria.local":       {"tcp://kria.local:5560", "tcp://kria.local:5562"},
		"tcp://[fe80::1%eth0]":   {"tcp://[fe80::1%eth0]:5560", "tcp://[fe80::1%eth0]:5562"},
		"tcp://[::1]:7000":       {"tcp://[::1]:7000", "tcp://[::1]:7002"},
		"ipc:///run/cm":          {"ipc:///run/cm/pub", "ipc:///run/cm/req"},
		"/tmp/x":                 {"ipc:///tmp/x/pub", "ipc:///tmp/x/req"},
		"tcp://kria.local:65534": {},
		"tcp://":                 {},
	} {
		pub, req, err := endpoints(place)
		if pub != want[0] || req != want[1] || (err == nil) != (want[0] != "") {
			t.Errorf("%s: %s %s %v", place, pub, req, err)
		}
	}
}

func TestUnknownTypesOfMessagesAreNotMistakenForReplies(t *testing.T) {
	b := &Board{pending: map[string]chan<- result{}}
	came := make(chan result, 1)
	b.pending["1"] = came
	b.deliver("2", nil, nil) // a number that nobody waits for
	b.deliver("1", []byte{0xFF}, nil)
	if r := <-came; code(r.err) != "bad_answer" {
		t.Fatal(r.err)
	}
}
