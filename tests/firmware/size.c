/* SPDX-License-Identifier: Apache-2.0 */
/* All functions that a robot may call, to measure their code size on a Cortex-M. */
#ifdef SIZE_OF_BLE
#include "slam_ble_models.h"
#else
#include "slam_mqttsn.h"
#endif

typedef void (*any_function)(void);
extern const any_function all_functions[];

const any_function all_functions[] = {
#ifdef SIZE_OF_BLE
    (any_function)slam_ble_encode,         (any_function)slam_ble_decode,
    (any_function)slam_ble_encode_status,  (any_function)slam_ble_acknowledges,
    (any_function)slam_encode_positions,   (any_function)slam_decode_positions,
    (any_function)slam_ble_repeat_begin,   (any_function)slam_ble_repeat_end,
    (any_function)slam_ble_repeat_is_open, (any_function)slam_ble_repeat_step,
    (any_function)slam_ble_repeat_wait_ms,
#else
    (any_function)slam_sn_init,       (any_function)slam_sn_connect,
    (any_function)slam_sn_is_ready,   (any_function)slam_sn_is_publishing,
    (any_function)slam_sn_is_dozing,  (any_function)slam_sn_publish,
    (any_function)slam_sn_sleep,      (any_function)slam_sn_wake,
    (any_function)slam_sn_disconnect, (any_function)slam_sn_receive,
    (any_function)slam_sn_poll,       (any_function)slam_sn_wait_ms,
    (any_function)slam_sn_is_of_type,
#endif
};
