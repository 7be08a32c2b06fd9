// SPDX-License-Identifier: Apache-2.0
// The C headers for robots, as a C++ program includes them. They use C casts.
#pragma once

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wold-style-cast"
extern "C" {
#include "firmware/slam_ble_models.h"
#include "firmware/slam_mqttsn.h"
}
#pragma GCC diagnostic pop
