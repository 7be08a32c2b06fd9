// SPDX-License-Identifier: Apache-2.0
// Feeds random octets, as if from the serial port, to the decoders of Nordic's frames and events,
// of COBS, and of the older robots' frames.
#include <cstdlib>

#include "adapters/ble_mesh_usb_cdc/cobs/cobs_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"

using namespace slamgw::ble;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const slamgw::ByteView bytes(data, size);
  FrameDecoder decoder;
  for (const slamgw::Bytes& frame : decoder.on_bytes(bytes, {})) (void)decode_event(frame);
  CobsSplitter splitter;
  for (const slamgw::Bytes& frame : splitter.on_bytes(bytes)) {
    const auto raw = decode_cobs(frame);
    if (raw.has_value()) (void)decode_lien_frame(*raw);
  }
  const auto again = decode_cobs(encode_cobs(bytes));
  if (!again.has_value() || !std::equal(bytes.begin(), bytes.end(), again->begin())) std::abort();
  return 0;
}
