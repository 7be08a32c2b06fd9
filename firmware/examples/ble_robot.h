// SPDX-License-Identifier: Apache-2.0
// The functions that ble_robot.c offers to the firmware around it, and the ones that it needs.
#ifndef BLE_ROBOT_H
#define BLE_ROBOT_H

#include <stddef.h>
#include <stdint.h>

// Call when the robot is in the mesh. `random` must differ from start to start.
void robot_start(uint32_t now, uint8_t random);
// Call every 20 ms or so.
void robot_run(uint32_t now);
// Call with each message of company 0x0059, opcode first.
void robot_heard(const uint8_t* octets, size_t size);

// Publishes with the sensor_update client, to the address that the gateway has configured. In
// Nordic's mesh SDK: access_model_publish() with opcode octets[0], company 0x0059 and the
// parameters from octets + 3.
void mesh_publish(const uint8_t* octets, size_t size);
// Answers the message that is being heard. Nordic's mesh SDK: access_model_reply().
void mesh_reply(const uint8_t* octets, size_t size);

// Writes the robot's present position.
void robot_place(int16_t* x_cm, int16_t* y_cm);
void robot_drive_to(int16_t x_cm, int16_t y_cm);

#endif
