// SPDX-License-Identifier: Apache-2.0
#include "simulation/thread/fleet.hpp"

#include <fmt/format.h>
#include <sys/resource.h>

#include <boost/asio/signal_set.hpp>
#include <cmath>
#include <deque>
#include <stdexcept>

#include "simulation/thread/robot_socket.hpp"
#include "simulation/update_record.hpp"

namespace slamgw::sim::sn {
namespace {

namespace asio = boost::asio;
using boost::system::error_code;

constexpr int unreachable = 1;
constexpr unsigned max_search_delay_ms = 2000;  // Nordic's random wait before SEARCHGW
constexpr std::chrono::seconds progress_interval{10};

/// A socket for each robot: the usual soft limit of 1024 descriptors is too low for 1000 robots.
void raise_descriptor_limit() {
  rlimit limit{};
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  setrlimit(RLIMIT_NOFILE, &limit);
}

Duration to_duration(double seconds) {
  return std::chrono::duration_cast<Duration>(std::chrono::duration<double>(seconds));
}

/// Spreads `part` of the robots evenly over their numbers.
bool is_among(unsigned number, double part) {
  return std::floor(number * part) > std::floor((number - 1) * part);
}

class Fleet {
 public:
  Fleet(const ThreadOptions& options, const asio::ip::udp::endpoint& gateway);
  int run();

 private:
  ClientSettings settings_of(unsigned number) const;
  std::vector<Hop> path() const;
  void add_robot(unsigned number, const asio::ip::udp::endpoint& gateway);
  void on_change(RobotSocket& robot);
  void on_all_done();
  void stop_all();
  void report_progress();
  void give_up_unless_connected();
  std::size_t count_connected() const;

  const ThreadOptions& options_;
  asio::io_context io_;
  asio::signal_set signals_{io_, SIGINT, SIGTERM};
  asio::steady_timer linger_{io_};
  asio::steady_timer progress_{io_};
  asio::steady_timer patience_{io_};
  std::deque<RobotSocket> robots_;
  UpdateRecord record_;
  std::size_t done_ = 0;
  std::size_t finished_ = 0;
  bool is_stopping_ = false;
};

Fleet::Fleet(const ThreadOptions& options, const asio::ip::udp::endpoint& gateway)
    : options_(options), record_(options.common.record, options.common.trace, "thread") {
  for (unsigned number = 1; number <= options.common.robots; ++number) add_robot(number, gateway);
}

ClientSettings Fleet::settings_of(unsigned number) const {
  const RobotOptions& common = options_.common;
  // A small fleet starts at once; a large one takes Nordic's two seconds.
  const unsigned spread_ms = std::min(max_search_delay_ms, 2 * common.robots);
  ClientSettings settings;
  settings.client_id = common.id_of(number);
  settings.topic_prefix = options_.topic_prefix;
  settings.qos = options_.qos;
  settings.messages = common.limit();
  settings.period = common.period();
  settings.start_delay =
      std::chrono::milliseconds{Random(common.seed, number, Random::Use::start).below(spread_ms)};
  settings.obeys = common.obeys;
  settings.hears = options_.hears;
  settings.keep_alive = std::chrono::seconds{options_.keep_alive_s};
  settings.is_clean = options_.is_clean;
  settings.sleep = std::chrono::seconds{options_.sleep_s};
  settings.will_interval = to_duration(options_.will_updates_s);
  settings.resumes = options_.sleep_s > 0 || options_.roam_s > 0;
  settings.vanishes = is_among(number, options_.vanish);
  settings.retry_interval = to_duration(options_.retry_s);
  settings.outstanding = options_.outstanding;
  settings.is_recorded = common.is_recorded();
  settings.predefined_id = static_cast<std::uint16_t>(number);
  return settings;
}

/// Returns nothing without options for hops; then --loss and --delay-ms apply.
std::vector<Hop> Fleet::path() const {
  std::vector<Hop> hops;
  const HopOptions& hop = options_.common.hop;
  if (!hop.is_given()) return hops;
  for (unsigned i = 0; i < options_.hops; ++i) {
    hops.push_back({hop.loss_of(i), to_duration(hop.delay_ms_of(i) / 1000)});
  }
  return hops;
}

void Fleet::add_robot(unsigned number, const asio::ip::udp::endpoint& gateway) {
  const std::uint64_t seed = options_.common.seed;
  const ImpairmentSettings radio{options_.common.loss, options_.duplicate, options_.reorder,
                                 std::chrono::milliseconds{options_.delay_ms}, path()};
  robots_.emplace_back(io_, gateway,
                       Client(settings_of(number), RobotBody(seed, number, options_.common.body)),
                       Impairment(radio, Random(seed, number, Random::Use::uplink)),
                       Impairment(radio, Random(seed, number, Random::Use::downlink)),
                       [this](RobotSocket& robot) { on_change(robot); });
  if (options_.roam_s == 0) return;
  // Not all at once.
  const double first_s = options_.roam_s * Random(seed, number, Random::Use::roam).unit();
  robots_.back().roam(to_duration(first_s), to_duration(options_.roam_s));
}

int Fleet::run() {
  signals_.async_wait([this](error_code error, int) {
    if (error) return;
    signals_.clear();  // a second signal ends the program at once
    stop_all();
  });
  for (RobotSocket& robot : robots_) robot.start();
  report_progress();
  const bool is_connecting = options_.qos >= 0;
  if (is_connecting && options_.give_up_s > 0) give_up_unless_connected();
  io_.run();

  std::vector<std::pair<std::string, Tally>> tallies;
  for (const RobotSocket& robot : robots_) {
    tallies.emplace_back(robot.client().id(), robot.client().tally());
  }
  fmt::print("{}\n", to_json(tallies));
  if (!is_connecting || count_connected() > 0) return 0;
  fmt::print(stderr, "slam-gateway-sim: no robot got connected to the gateway at {} port {}\n",
             options_.host, options_.port);
  return unreachable;
}

void Fleet::on_change(RobotSocket& robot) {
  while (const auto event = robot.next_event()) record_.write(robot.client().id(), *event);
  if (!robot.is_counted_done && robot.client().has_sent_everything()) {
    robot.is_counted_done = true;
    if (robot.client().is_stranded()) {
      fmt::print(stderr, "{}: stranded by CONNACK 01, as Nordic's client would be\n",
                 robot.client().id());
    }
    if (++done_ == robots_.size()) on_all_done();
  }
  if (!robot.is_counted_finished && robot.client().is_finished()) {
    robot.is_counted_finished = true;
    if (++finished_ == robots_.size()) io_.stop();
  }
}

void Fleet::on_all_done() {
  if (is_stopping_) return;
  linger_.expires_after(options_.common.linger());
  linger_.async_wait([this](error_code error) {
    if (!error) stop_all();
  });
}

void Fleet::stop_all() {
  if (std::exchange(is_stopping_, true)) return;
  for (RobotSocket& robot : robots_) robot.stop();
}

void Fleet::report_progress() {
  progress_.expires_after(progress_interval);
  progress_.async_wait([this](error_code error) {
    if (error) return;
    std::uint64_t sent = 0;
    for (const RobotSocket& robot : robots_) sent += robot.client().tally().sent;
    fmt::print(stderr, "{} of {} robots have been connected, {} updates sent\n", count_connected(),
               robots_.size(), sent);
    report_progress();
  });
}

void Fleet::give_up_unless_connected() {
  patience_.expires_after(to_duration(options_.give_up_s));
  patience_.async_wait([this](error_code error) {
    if (!error && count_connected() == 0) stop_all();
  });
}

std::size_t Fleet::count_connected() const {
  return static_cast<std::size_t>(
      std::count_if(robots_.begin(), robots_.end(),
                    [](const RobotSocket& robot) { return robot.client().was_connected(); }));
}

}  // namespace

int run_fleet(const ThreadOptions& options) {
  raise_descriptor_limit();
  asio::io_context io;
  error_code error;
  const auto found = asio::ip::udp::resolver(io).resolve(options.host, options.port, error);
  if (error || found.empty()) {
    fmt::print(stderr, "slam-gateway-sim: {} is not known: {}\n", options.host, error.message());
    return unreachable;
  }
  try {
    return Fleet(options, found.begin()->endpoint()).run();
  } catch (const std::runtime_error& failure) {  // a socket, or the record
    fmt::print(stderr, "slam-gateway-sim: {}\n", failure.what());
    return unreachable;
  }
}

}  // namespace slamgw::sim::sn
