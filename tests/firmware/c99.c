/* SPDX-License-Identifier: Apache-2.0 */
/* Both headers as a C99 program includes them, with smaller bounds. */
#define SLAM_SN_MAX_PACKET 64u
#define SLAM_SN_MAX_TOPICS 2u
#define SLAM_SN_MAX_HEARD 1u
#define SLAM_SN_MAX_NAME 16u
#include "slam_ble_models.h"
#include "slam_mqttsn.h"

size_t c99_connect(uint8_t* out, size_t capacity);

/* Writes the first datagram of a client with packets of 64 octets, and returns its size. */
size_t c99_connect(uint8_t* out, size_t capacity) {
  static const struct slam_sn_topic topics[] = {{"a/b", 0, 0}};
  static const struct slam_sn_settings settings = {"r1", NULL, NULL, topics, 1, 0, true, 0, 60, 0};
  static struct slam_sn_client client;
  const uint8_t* octets = NULL;
  size_t size = 0;
  size_t i = 0;
  if (!slam_sn_init(&client, &settings, 7)) return 0;
  slam_sn_connect(&client, 0);
  octets = slam_sn_poll(&client, 0, &size);
  for (i = 0; i < size && i < capacity; ++i) out[i] = octets[i];
  return size;
}
