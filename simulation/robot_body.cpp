// SPDX-License-Identifier: Apache-2.0
#include "simulation/robot_body.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

namespace slamgw::sim {
namespace {

constexpr double ring_radius_cm = 80;
constexpr double roaming_radius_cm = 68;  // the robot's own size keeps its centre off the wall
constexpr double step_cm = 2;             // 10 cm/s at an update each 200 ms
constexpr double max_turn_rad = 20 * std::numbers::pi / 180;
constexpr double arrived_cm = 4;
constexpr unsigned sensor_count = 4;
constexpr long max_range_cm = 80;
constexpr long nothing_seen_cm = 13;  // thesis: 13 cm or less means "no obstacle"
constexpr double missed_echo = 0.05;

/// Along the ray from (x, y), which is inside, to the ring.
double distance_to_ring(double x, double y, double angle) {
  const double along = x * std::cos(angle) + y * std::sin(angle);
  return std::sqrt(along * along + ring_radius_cm * ring_radius_cm - x * x - y * y) - along;
}

std::int16_t to_cm(double value) { return static_cast<std::int16_t>(std::lround(value)); }

}  // namespace

RobotBody::RobotBody(std::uint64_t seed, unsigned number)
    : random_(seed, number, Random::Use::body), number_(number) {
  choose_target();
  x_cm_ = target_x_cm_;
  y_cm_ = target_y_cm_;
  heading_rad_ = random_.unit() * 2 * std::numbers::pi;
  tower_degrees_ = static_cast<int>(random_.below(19)) * 5;
  choose_target();
}

Bytes RobotBody::introduction() const {
  Bytes out;
  put_u16_le(out, static_cast<std::uint16_t>(number_));
  put(out, Bytes{13, 18, 9, 6});
  return out;
}

Bytes RobotBody::next_update() {
  move();
  Bytes out;
  put_i16_le(out, to_cm(x_cm_));
  put_i16_le(out, to_cm(y_cm_));
  for (unsigned sensor = 0; sensor < sensor_count; ++sensor) append_obstacle(out, sensor);
  put_u8(out, static_cast<std::uint8_t>(random_.below(256)));
  return out;
}

void RobotBody::head_for(std::int16_t x_cm, std::int16_t y_cm) {
  const double distance = std::hypot(x_cm, y_cm);
  const double scale = distance > roaming_radius_cm ? roaming_radius_cm / distance : 1;
  target_x_cm_ = x_cm * scale;
  target_y_cm_ = y_cm * scale;
}

void RobotBody::choose_target() {
  const double radius = roaming_radius_cm * std::sqrt(random_.unit());
  const double angle = random_.unit() * 2 * std::numbers::pi;
  target_x_cm_ = radius * std::cos(angle);
  target_y_cm_ = radius * std::sin(angle);
}

void RobotBody::move() {
  tower_degrees_ += tower_step_degrees_;
  if (tower_degrees_ <= 0 || tower_degrees_ >= 90) tower_step_degrees_ = -tower_step_degrees_;
  tower_degrees_ = std::clamp(tower_degrees_, 0, 90);
  if (!is_running_) return;

  const double wanted = std::atan2(target_y_cm_ - y_cm_, target_x_cm_ - x_cm_);
  const double turn = std::remainder(wanted - heading_rad_, 2 * std::numbers::pi);
  heading_rad_ += std::clamp(turn, -max_turn_rad, max_turn_rad);
  const double x = x_cm_ + step_cm * std::cos(heading_rad_);
  const double y = y_cm_ + step_cm * std::sin(heading_rad_);
  if (std::hypot(x, y) <= roaming_radius_cm) {  // else it only turns on the spot
    x_cm_ = x;
    y_cm_ = y;
  }
  if (std::hypot(target_x_cm_ - x_cm_, target_y_cm_ - y_cm_) < arrived_cm) choose_target();
}

void RobotBody::append_obstacle(Bytes& out, unsigned sensor) {
  const bool is_missed = random_.chance(missed_echo);
  const long noise_cm = static_cast<long>(random_.below(3)) - 1;
  const double degrees = tower_degrees_ + 90.0 * sensor;
  const double angle = heading_rad_ + degrees * std::numbers::pi / 180;
  const long reading_cm = std::lround(distance_to_ring(x_cm_, y_cm_, angle)) + noise_cm;
  if (is_missed || reading_cm <= nothing_seen_cm || reading_cm > max_range_cm) return;
  put_i16_le(out, to_cm(x_cm_ + static_cast<double>(reading_cm) * std::cos(angle)));
  put_i16_le(out, to_cm(y_cm_ + static_cast<double>(reading_cm) * std::sin(angle)));
}

}  // namespace slamgw::sim
