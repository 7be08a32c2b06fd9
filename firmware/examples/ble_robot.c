// SPDX-License-Identifier: Apache-2.0
// A robot on BLE Mesh: it says where it is each 200 ms and obeys `cmd`. The functions that are only
// declared here are calls of the mesh stack and of the robot's body.
#include "ble_robot.h"

#include "slam_ble_models.h"

#define UPDATE_PERIOD_MS 200u
#define TTL 4u  // what the gateway has configured the models to publish with

static uint8_t open_update[SLAM_BLE_OPCODE_SIZE + 1 + SLAM_POSITION_SIZE];
static size_t open_size = 0;
static struct slam_ble_message sent;
static struct slam_ble_repeat repeat;
static uint8_t next_number = 0;
static uint32_t next_update = 0;

void robot_start(uint32_t now, uint8_t random) {
  next_number = random;
  next_update = now;
  slam_ble_repeat_end(&repeat);
}

// One position fits in one segment with its number: 3 + 1 + 4 octets.
static void say_where(uint32_t now) {
  struct slam_position place;
  static uint8_t parameters[SLAM_POSITION_SIZE];
  robot_place(&place.x_cm, &place.y_cm);
  sent.model = SLAM_BLE_SENSOR_UPDATE;
  sent.kind = SLAM_BLE_SET_NUMBERED;
  sent.has_number = true;
  sent.number = next_number++;
  sent.data = parameters;
  sent.size = slam_encode_positions(&place, 1, parameters, sizeof parameters);
  open_size = slam_ble_encode(&sent, open_update, sizeof open_update);
  slam_ble_repeat_begin(&repeat, now, TTL, open_size);
  mesh_publish(open_update, open_size);
}

// The next update waits until this one is acknowledged or given up.
void robot_run(uint32_t now) {
  if (slam_ble_repeat_is_open(&repeat)) {
    if (slam_ble_repeat_step(&repeat, now) == SLAM_BLE_SEND_AGAIN)
      mesh_publish(open_update, open_size);
    return;
  }
  if (now - next_update >= UINT32_C(0x80000000)) return;
  next_update = now + UPDATE_PERIOD_MS;
  say_where(now);
}

void robot_heard(const uint8_t* octets, size_t size) {
  struct slam_ble_message message;
  struct slam_position target;
  uint8_t status[SLAM_BLE_OPCODE_SIZE + 2];
  if (!slam_ble_decode(octets, size, &message)) return;
  if (slam_ble_acknowledges(&message, &sent)) slam_ble_repeat_end(&repeat);
  if (message.model == SLAM_BLE_SENSOR_UPDATE) return;  // nothing else of this model is for a robot
  if (message.model == SLAM_BLE_POS_CMD && message.kind != SLAM_BLE_GET &&
      slam_decode_positions(message.data, message.size, &target, 1) == 1)
    robot_drive_to(target.x_cm, target.y_cm);
  const size_t status_size = slam_ble_encode_status(&message, status, sizeof status);
  if (status_size > 0) mesh_reply(status, status_size);
}
