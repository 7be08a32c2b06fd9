// SPDX-License-Identifier: Apache-2.0
// The messages between a robot on BLE Mesh and the gateway, those of the vendor models min_com,
// sensor_update and pos_cmd; the positions inside them; and the times at which a message that was
// not acknowledged is sent again. C99 without dependencies: octets in, octets out. docs/robots.md
// shows how a robot uses this header, firmware/examples/ble_robot.c is an example.
#ifndef SLAM_BLE_MODELS_H
#define SLAM_BLE_MODELS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

// The company of the models. It goes little-endian behind the opcode: 59 00.
#define SLAM_BLE_COMPANY 0x0059u
// Model identifiers of the clients; a server's identifier is one higher than its client's.
#define SLAM_BLE_MIN_COM_CLIENT 0x0004u
#define SLAM_BLE_SENSOR_UPDATE_CLIENT 0x0006u
#define SLAM_BLE_POS_CMD_CLIENT 0x0008u

#define SLAM_BLE_OPCODE_SIZE 3u
// Octets of the longest message that reaches the gateway, opcode included.
#define SLAM_BLE_MAX_SIZE 235u
// A message of at most this many octets, opcode included, needs one segment.
#define SLAM_BLE_UNSEGMENTED_SIZE 11u

enum slam_ble_model { SLAM_BLE_MIN_COM, SLAM_BLE_SENSOR_UPDATE, SLAM_BLE_POS_CMD };

enum slam_ble_kind {
  SLAM_BLE_SET,             // repeated until a STATUS comes
  SLAM_BLE_GET,             // asks for a STATUS
  SLAM_BLE_SET_UNRELIABLE,  // sent once, never acknowledged
  SLAM_BLE_STATUS,          // acknowledges a SET, a GET or a SET_NUMBERED
  SLAM_BLE_SET_NUMBERED     // a SET with a transaction number, which its repeats share
};

struct slam_ble_message {
  enum slam_ble_model model;
  enum slam_ble_kind kind;
  bool has_number;      // true for a SET_NUMBERED, and for the STATUS that answers one
  uint8_t number;       // the transaction number
  const uint8_t* data;  // the parameters without the number; of a STATUS its state octet
  size_t size;
};

// The first opcode octet of each kind: c5..c8 min_com, c9..cc sensor_update, cd..d0 pos_cmd, and
// d1, d2, d3 their SET_NUMBERED.
static inline uint8_t slam_ble_opcode(enum slam_ble_model model, enum slam_ble_kind kind) {
  if (kind == SLAM_BLE_SET_NUMBERED) return (uint8_t)(0xd1u + (unsigned)model);
  return (uint8_t)(0xc5u + 4u * (unsigned)model + (unsigned)kind);
}

// Writes the message with its opcode, and returns its size. Returns 0 when `out` is too small, or
// the message too long. A mesh stack that takes the opcode apart gets `out[0]`, SLAM_BLE_COMPANY,
// and the parameters from `out + SLAM_BLE_OPCODE_SIZE`.
static inline size_t slam_ble_encode(const struct slam_ble_message* message, uint8_t* out,
                                     size_t capacity) {
  const bool is_numbered = message->kind == SLAM_BLE_SET_NUMBERED;
  const bool ends_with_number = message->kind == SLAM_BLE_STATUS && message->has_number;
  size_t at = 0;
  size_t i = 0;
  if (message->size > SLAM_BLE_MAX_SIZE) return 0;
  const size_t total =
      SLAM_BLE_OPCODE_SIZE + message->size + (is_numbered || ends_with_number ? 1u : 0u);
  if (total > capacity || total > SLAM_BLE_MAX_SIZE) return 0;
  out[at++] = slam_ble_opcode(message->model, message->kind);
  out[at++] = SLAM_BLE_COMPANY & 0xffu;
  out[at++] = SLAM_BLE_COMPANY >> 8;
  if (is_numbered) out[at++] = message->number;
  for (i = 0; i < message->size; ++i) out[at++] = message->data[i];
  if (ends_with_number) out[at++] = message->number;
  return at;
}

// Reads a message whose opcode the mesh stack has taken off: `opcode` is the first octet of the
// opcode, and the company was SLAM_BLE_COMPANY. Returns false for any other message, or an invalid
// one. `data` then points into `parameters`.
static inline bool slam_ble_decode_parameters(uint8_t opcode, const uint8_t* parameters,
                                              size_t size, struct slam_ble_message* message) {
  if (opcode < 0xc5u || opcode > 0xd3u) return false;
  const unsigned place = opcode - 0xc5u;
  const bool is_numbered = place >= 12u;
  message->model = (enum slam_ble_model)(is_numbered ? place - 12u : place / 4u);
  message->kind = is_numbered ? SLAM_BLE_SET_NUMBERED : (enum slam_ble_kind)(place % 4u);
  message->has_number = is_numbered;
  message->number = 0;
  message->data = parameters;
  message->size = size;
  if (is_numbered) {
    if (size == 0) return false;
    message->number = *message->data++;
    --message->size;
  } else if (message->kind == SLAM_BLE_STATUS) {
    if (size > 2) return false;
    message->has_number = size == 2;
    if (message->has_number) message->number = parameters[--message->size];
  }
  return true;
}

// Reads a whole access message, opcode first, like slam_ble_decode_parameters().
static inline bool slam_ble_decode(const uint8_t* octets, size_t size,
                                   struct slam_ble_message* message) {
  if (size < SLAM_BLE_OPCODE_SIZE) return false;
  if (octets[1] != (SLAM_BLE_COMPANY & 0xffu) || octets[2] != SLAM_BLE_COMPANY >> 8) return false;
  return slam_ble_decode_parameters(octets[0], octets + SLAM_BLE_OPCODE_SIZE,
                                    size - SLAM_BLE_OPCODE_SIZE, message);
}

// Writes the STATUS that answers `request`. Returns 0 for a message that needs no answer.
static inline size_t slam_ble_encode_status(const struct slam_ble_message* request, uint8_t* out,
                                            size_t capacity) {
  static const uint8_t state = 0;
  struct slam_ble_message status;
  if (request->kind == SLAM_BLE_STATUS || request->kind == SLAM_BLE_SET_UNRELIABLE) return 0;
  status.model = request->model;
  status.kind = SLAM_BLE_STATUS;
  status.has_number = request->has_number;
  status.number = request->number;
  status.data = &state;
  status.size = 1;
  return slam_ble_encode(&status, out, capacity);
}

// Returns true if `status` acknowledges `sent`. A late STATUS for an earlier number does not.
static inline bool slam_ble_acknowledges(const struct slam_ble_message* status,
                                         const struct slam_ble_message* sent) {
  if (status->kind != SLAM_BLE_STATUS || status->model != sent->model) return false;
  if (sent->kind != SLAM_BLE_SET_NUMBERED) return true;
  return status->has_number && status->number == sent->number;
}

// Positions: the payload of `update` (the robot's own, then up to four obstacles) and of `cmd` (the
// target alone), on both meshes.

struct slam_position {
  int16_t x_cm;
  int16_t y_cm;
};

#define SLAM_MAX_POSITIONS 5u
#define SLAM_POSITION_SIZE 4u

// Returns the number of octets, 0 when there is no room, no position, or more than five.
static inline size_t slam_encode_positions(const struct slam_position* positions, size_t count,
                                           uint8_t* out, size_t capacity) {
  size_t i = 0;
  if (count < 1 || count > SLAM_MAX_POSITIONS || count * SLAM_POSITION_SIZE > capacity) return 0;
  for (i = 0; i < count; ++i) {
    const uint16_t x = (uint16_t)positions[i].x_cm;
    const uint16_t y = (uint16_t)positions[i].y_cm;
    *out++ = (uint8_t)(x & 0xffu);
    *out++ = (uint8_t)(x >> 8);
    *out++ = (uint8_t)(y & 0xffu);
    *out++ = (uint8_t)(y >> 8);
  }
  return count * SLAM_POSITION_SIZE;
}

static inline int16_t slam_read_i16_(const uint8_t* octets) {
  return (int16_t)(uint16_t)(octets[0] | (unsigned)octets[1] << 8);
}

// Returns the number of positions, 0 when `size` is not 4n or 4n + 1 with n from 1 to `capacity`.
static inline size_t slam_decode_positions(const uint8_t* octets, size_t size,
                                           struct slam_position* positions, size_t capacity) {
  const size_t count = size / SLAM_POSITION_SIZE;
  size_t i = 0;
  if (count < 1 || count > capacity || size % SLAM_POSITION_SIZE > 1) return 0;
  for (i = 0; i < count; ++i) {
    positions[i].x_cm = slam_read_i16_(octets + i * SLAM_POSITION_SIZE);
    positions[i].y_cm = slam_read_i16_(octets + i * SLAM_POSITION_SIZE + 2);
  }
  return count;
}

// Repeats of a SET or SET_NUMBERED: iv, 2iv, 4iv ... after its first copy, until its STATUS comes
// or a minute has passed. The gateway knows repeats by these distances. For mesh stacks without a
// reliable publish of their own; Nordic's access layer has one.

#define SLAM_BLE_GIVE_UP_MS 60000u

struct slam_ble_repeat {
  uint32_t first_at;  // ms, by any clock that wraps at 2^32
  uint32_t after;     // the next copy's distance from the first; 0: no message is open
};

enum slam_ble_step { SLAM_BLE_WAIT, SLAM_BLE_SEND_AGAIN, SLAM_BLE_GIVE_UP };

// Returns iv: 200 ms, plus 20 ms for each hop that the TTL allows, plus 20 ms for each segment if
// segmented.
static inline uint32_t slam_ble_interval_ms(uint8_t ttl, size_t message_size) {
  const uint32_t unsegmented_ms = 200u + 20u * ttl;
  if (message_size <= SLAM_BLE_UNSEGMENTED_SIZE) return unsegmented_ms;
  return unsegmented_ms + 20u * (uint32_t)((message_size + 4u + 11u) / 12u);
}

// Call when the first copy is sent.
static inline void slam_ble_repeat_begin(struct slam_ble_repeat* repeat, uint32_t now, uint8_t ttl,
                                         size_t message_size) {
  repeat->first_at = now;
  repeat->after = slam_ble_interval_ms(ttl, message_size);
}

// Call when the STATUS has come.
static inline void slam_ble_repeat_end(struct slam_ble_repeat* repeat) { repeat->after = 0; }

static inline bool slam_ble_repeat_is_open(const struct slam_ble_repeat* repeat) {
  return repeat->after != 0;
}

// Returns the step to take now. A caller that comes late sends one copy for all that it missed.
static inline enum slam_ble_step slam_ble_repeat_step(struct slam_ble_repeat* repeat,
                                                      uint32_t now) {
  const uint32_t passed = now - repeat->first_at;
  if (repeat->after == 0) return SLAM_BLE_WAIT;
  if (passed >= SLAM_BLE_GIVE_UP_MS) {
    repeat->after = 0;
    return SLAM_BLE_GIVE_UP;
  }
  if (passed < repeat->after) return SLAM_BLE_WAIT;
  while (repeat->after <= passed) repeat->after *= 2u;
  return SLAM_BLE_SEND_AGAIN;
}

// Returns the milliseconds until slam_ble_repeat_step() has something to do; UINT32_MAX: never.
static inline uint32_t slam_ble_repeat_wait_ms(const struct slam_ble_repeat* repeat, uint32_t now) {
  const uint32_t passed = now - repeat->first_at;
  const uint32_t next = repeat->after < SLAM_BLE_GIVE_UP_MS ? repeat->after : SLAM_BLE_GIVE_UP_MS;
  if (repeat->after == 0) return UINT32_MAX;
  return passed >= next ? 0 : next - passed;
}

#ifdef __cplusplus
}
#endif

#endif
