// SPDX-License-Identifier: Apache-2.0
// The lowest cost of answering a ping on this machine: a thread that waits for a datagram and
// answers it.
#pragma once

#include <thread>

#include "tests/bench/address.hpp"

namespace slamgw::bench {

class EchoFloor {
 public:
  EchoFloor();
  ~EchoFloor();
  EchoFloor(const EchoFloor&) = delete;
  EchoFloor& operator=(const EchoFloor&) = delete;

  Address address() const;
  /// Processor time of its thread.
  double cpu_s();

 private:
  void answer() const;

  int descriptor_;
  std::thread thread_;
};

}  // namespace slamgw::bench
