// SPDX-License-Identifier: Apache-2.0
// The vendor models of a robot for Zephyr's mesh stack, in front of ble_robot.c. Checked by review
// against Zephyr's bluetooth/mesh/access.h; neither compiled nor run.
#include <errno.h>
#include <string.h>
#include <zephyr/bluetooth/mesh.h>

#include "ble_robot.h"
#include "slam_ble_models.h"

#define OP(first) BT_MESH_MODEL_OP_3(first, SLAM_BLE_COMPANY)

// Without `const` before Zephyr 3.6.
typedef const struct bt_mesh_model model_t;

static model_t* heard_by;  // the message that is being heard
static struct bt_mesh_msg_ctx* heard_from;

static int heard(uint8_t first, model_t* model, struct bt_mesh_msg_ctx* from,
                 struct net_buf_simple* parameters) {
  uint8_t octets[SLAM_BLE_MAX_SIZE] = {first, SLAM_BLE_COMPANY & 0xff, SLAM_BLE_COMPANY >> 8};
  if (parameters->len > sizeof octets - SLAM_BLE_OPCODE_SIZE) return -EMSGSIZE;
  memcpy(octets + SLAM_BLE_OPCODE_SIZE, parameters->data, parameters->len);
  heard_by = model;
  heard_from = from;
  robot_heard(octets, SLAM_BLE_OPCODE_SIZE + parameters->len);
  return 0;
}

static int on_status(model_t* model, struct bt_mesh_msg_ctx* from, struct net_buf_simple* message) {
  return heard(0xcc, model, from, message);
}

static int on_pos_cmd(model_t* model, struct bt_mesh_msg_ctx* from,
                      struct net_buf_simple* message) {
  return heard(0xcd, model, from, message);
}

static const struct bt_mesh_model_op update_ops[] = {
    {OP(0xcc), BT_MESH_LEN_MIN(1), on_status},
    BT_MESH_MODEL_OP_END,
};
static const struct bt_mesh_model_op pos_cmd_ops[] = {
    {OP(0xcd), BT_MESH_LEN_MIN(4), on_pos_cmd},
    BT_MESH_MODEL_OP_END,
};

BT_MESH_MODEL_PUB_DEFINE(update_pub, NULL, SLAM_BLE_MAX_SIZE);

// The vendor models of the element: its SIG models are the configuration server, the health server
// and the Generic OnOff server.
model_t vendor_models[] = {
    BT_MESH_MODEL_VND(SLAM_BLE_COMPANY, SLAM_BLE_SENSOR_UPDATE_CLIENT, update_ops, &update_pub,
                      NULL),
    BT_MESH_MODEL_VND(SLAM_BLE_COMPANY, SLAM_BLE_POS_CMD_CLIENT + 1, pos_cmd_ops, NULL, NULL),
};

static void put(struct net_buf_simple* message, const uint8_t* octets, size_t size) {
  bt_mesh_model_msg_init(message, OP(octets[0]));
  net_buf_simple_add_mem(message, octets + SLAM_BLE_OPCODE_SIZE, size - SLAM_BLE_OPCODE_SIZE);
}

void mesh_publish(const uint8_t* octets, size_t size) {
  put(update_pub.msg, octets, size);
  bt_mesh_model_publish(&vendor_models[0]);
}

void mesh_reply(const uint8_t* octets, size_t size) {
  NET_BUF_SIMPLE_DEFINE(message, SLAM_BLE_MAX_SIZE + 4);  // and the MIC
  put(&message, octets, size);
  bt_mesh_model_send(heard_by, heard_from, &message, NULL, NULL);
}
