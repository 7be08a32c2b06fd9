// SPDX-License-Identifier: Apache-2.0
// A wall clock that is set back by an hour. Paho 1.3.12 waits for times of the wall clock; the
// kernel prolongs such a wait by the same hour. This program prolongs its own waits like that.
#include <dlfcn.h>
#include <gtest/gtest.h>
#include <pthread.h>

#include <atomic>
#include <chrono>
#include <ctime>
#include <stop_token>
#include <thread>

#include "tests/mqtt/broker_link.hpp"
#include "tests/mqtt/delivery_rig.hpp"
#include "tests/support/fake_broker.hpp"

namespace {

/// How far the wall clock is behind what it was when a wait began.
std::atomic<std::int64_t> set_back_s{0};
/// Waits that a step has made longer.
std::atomic<int> stretched{0};

using CondTimedwait = int (*)(pthread_cond_t*, pthread_mutex_t*, const timespec*);

CondTimedwait real_wait() {
  static const auto real =
      reinterpret_cast<CondTimedwait>(dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2"));
  return real;
}

std::int64_t in_ns(const timespec& time) {
  return std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

}  // namespace

/// Replaces glibc's function for every library of this program; polls the clock.
extern "C" int pthread_cond_timedwait(pthread_cond_t* condition, pthread_mutex_t* mutex,
                                      const timespec* until) {
  constexpr std::int64_t slice_ns = 5'000'000;
  const std::int64_t begun_at = set_back_s;
  for (;;) {
    timespec now{};
    clock_gettime(CLOCK_REALTIME, &now);
    const std::int64_t step = set_back_s - begun_at;
    const std::int64_t end = in_ns(*until) + step * 1'000'000'000;
    const std::int64_t wake = std::min(end, in_ns(now) + slice_ns);
    const timespec next{wake / 1'000'000'000, wake % 1'000'000'000};
    const int result = real_wait()(condition, mutex, &next);
    clock_gettime(CLOCK_REALTIME, &now);
    if (result != ETIMEDOUT || in_ns(now) >= end) return result;
    if (in_ns(now) >= in_ns(*until)) ++stretched;
  }
}

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using test::FakeBroker;

constexpr std::int64_t hour_s = 3600;

TEST(WallClockSetBack, DoesNotDelayTheMoveToTheNextBroker) {
  FakeBroker silent;
  silent.misbehave([](FakeBroker::Connection&, const FakeBroker::Packet& packet) {
    return packet.type() == FakeBroker::connect;
  });
  FakeBroker well;
  BrokerSettings settings = settings_for(silent.port());
  settings.others = {{"127.0.0.1", well.port(), false}};
  Link link(settings);
  // Repeats, because on a busy machine a wait may begin late.
  std::jthread clock([](const std::stop_token& stop) {
    for (; stretched == 0 && !stop.stop_requested(); std::this_thread::sleep_for(100ms))
      set_back_s += hour_s;
  });
  EXPECT_TRUE(link.comes_up());
  EXPECT_GT(stretched, 0) << "no wait used the wall clock, so the test shows nothing";
}

TEST(WallClockSetBack, DoesNotDelayMessages) {
  FakeBroker broker;
  DeliveryRig gateway(settings_for(broker.port()));
  ASSERT_TRUE(gateway.sees([&] { return gateway.is_up; }));
  for (std::uint64_t number = 1; number <= 300; ++number) {
    set_back_s += hour_s;
    gateway.submit("t", number);
    ASSERT_TRUE(gateway.sees([&] { return gateway.fired.size() == number; })) << number;
  }
}

}  // namespace
}  // namespace slamgw
