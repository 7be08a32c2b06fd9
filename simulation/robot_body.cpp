// SPDX-License-Identifier: Apache-2.0
#include "simulation/robot_body.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numbers>

namespace slamgw::sim {
namespace {

constexpr double degree = std::numbers::pi / 180;
constexpr double step_cm = 2;  // 10 cm/s at an update each 200 ms
constexpr double max_turn_rad = 20 * degree;
constexpr double arrived_cm = 4;
constexpr unsigned sensor_count = 4;
constexpr long max_range_cm = 80;
constexpr long nothing_seen_cm = 13;  // thesis: 13 cm or less means "no obstacle"
constexpr double missed_echo = 0.05;

// The thesis's robot. It turns on the spot and then drives (4.1); the angles of its tower are those
// of the sibling robot. The growth of scatter with distance is not specified (4.3.2), so it is
// chosen.
constexpr double thesis_turn_rad = 30 * degree;
constexpr double straight_enough_rad = 3 * degree;
constexpr int tower_step_standing = 1;
constexpr int tower_step_driving = 5;
constexpr double scatter_cm = 1;
constexpr double scatter_per_cm = 1.0 / 40;
constexpr long max_reading_cm = 255;  // uint8

std::int16_t to_cm(double value) { return static_cast<std::int16_t>(std::lround(value)); }

}  // namespace

RobotBody::RobotBody(std::uint64_t seed, unsigned number, const BodySettings& settings)
    : settings_(settings),
      world_(settings.world),
      random_(seed, number, Random::Use::body),
      number_(number),
      is_running_(!settings.stands) {
  target_ = world_.choose_target(random_);
  if (is_thesis()) return;  // it begins at (0, 0) with heading 0
  place_ = target_;
  heading_rad_ = random_.unit() * 2 * std::numbers::pi;
  tower_degrees_ = static_cast<int>(random_.below(19)) * 5;
  target_ = world_.choose_target(random_);
}

Bytes RobotBody::introduction() const {
  Bytes out;
  put_u16_le(out, static_cast<std::uint16_t>(number_));
  put(out, Bytes{13, 18, 9, 6});
  return out;
}

Bytes RobotBody::next_message(std::uint64_t count, Duration age) {
  if (settings_.payload != BodySettings::Payload::probe) return next_update();
  const auto age_ms = std::chrono::duration_cast<std::chrono::milliseconds>(age).count();
  Bytes out;
  put_u16_le(out, static_cast<std::uint16_t>(count & 0xffff));
  put_u32_le(out, static_cast<std::uint32_t>(age_ms & 0xffffffff));
  return out;
}

Bytes RobotBody::next_update() {
  is_thesis() ? move_thesis() : move_usual();
  std::vector<long> readings_cm;
  for (unsigned sensor = 0; sensor < sensor_count; ++sensor) {
    readings_cm.push_back(is_thesis() ? read_thesis(sensor) : read_usual(sensor));
  }
  const bool is_full = settings_.payload == BodySettings::Payload::full;
  return is_full ? full(readings_cm) : positions(readings_cm);
}

Bytes RobotBody::positions(const std::vector<long>& readings_cm) {
  Bytes out;
  append_point(out, place_.x_cm, place_.y_cm);
  for (unsigned sensor = 0; sensor < sensor_count; ++sensor) {
    append_obstacle(out, sensor, readings_cm[sensor]);
  }
  const auto stray = static_cast<std::uint8_t>(random_.below(256));
  out.resize(std::min<std::size_t>(out.size(), 4 + 4 * settings_.max_obstacles));
  if (settings_.has_stray) put_u8(out, stray);
  return out;
}

Bytes RobotBody::full(const std::vector<long>& readings_cm) const {
  Bytes out{0x01};
  append_point(out, place_.x_cm, place_.y_cm);
  const double heading_rad = is_compass() ? std::numbers::pi / 2 - heading_rad_ : heading_rad_;
  put_i16_le(out, to_cm(std::remainder(heading_rad, 2 * std::numbers::pi) / degree));
  put_i16_le(out, static_cast<std::int16_t>(tower_degrees_));
  for (const long reading_cm : readings_cm) {
    put_u8(out, static_cast<std::uint8_t>(std::clamp(reading_cm, 0L, max_reading_cm)));
  }
  return out;
}

void RobotBody::head_for(std::int16_t x_cm, std::int16_t y_cm) {
  target_ = world_.nearest_reachable({static_cast<double>(x_cm), static_cast<double>(y_cm)});
}

double RobotBody::turn_to_target() const {
  const double wanted = std::atan2(target_.y_cm - place_.y_cm, target_.x_cm - place_.x_cm);
  return std::remainder(wanted - heading_rad_, 2 * std::numbers::pi);
}

void RobotBody::drive(double distance_cm) {
  const Place next{place_.x_cm + distance_cm * std::cos(heading_rad_),
                   place_.y_cm + distance_cm * std::sin(heading_rad_)};
  if (world_.has_room_for_robot(next)) {  // else it only turns on the spot
    place_ = next;
  } else if (settings_.world == World::Shape::room) {
    target_ = world_.choose_target(random_);  // a corner is in the way
  }
  if (std::hypot(target_.x_cm - place_.x_cm, target_.y_cm - place_.y_cm) < arrived_cm) {
    target_ = world_.choose_target(random_);
  }
}

void RobotBody::move_usual() {
  tower_degrees_ += tower_step_degrees_;
  if (tower_degrees_ <= 0 || tower_degrees_ >= 90) tower_step_degrees_ = -tower_step_degrees_;
  tower_degrees_ = std::clamp(tower_degrees_, 0, 90);
  if (!is_running_) return;
  heading_rad_ += std::clamp(turn_to_target(), -max_turn_rad, max_turn_rad);
  drive(step_cm);
}

/// While the robot turns, the tower stands; while it drives, the tower turns five times faster.
void RobotBody::move_thesis() {
  const double turn = is_running_ ? turn_to_target() : 0;
  if (std::abs(turn) > straight_enough_rad) {
    heading_rad_ += std::clamp(turn, -thesis_turn_rad, thesis_turn_rad);
    return;
  }
  const int direction = tower_step_degrees_ > 0 ? 1 : -1;
  tower_degrees_ += direction * (is_running_ ? tower_step_driving : tower_step_standing);
  if (tower_degrees_ <= 0 || tower_degrees_ >= 90) tower_step_degrees_ = -tower_step_degrees_;
  tower_degrees_ = std::clamp(tower_degrees_, 0, 90);
  if (is_running_) drive(step_cm);
}

/// The thesis's angles count from +y towards +x, so its tower turns clockwise; those of the sibling
/// robot, whose pose makes the map mirrored, count the other way.
double RobotBody::beam_angle(unsigned sensor) const {
  const double tower_rad = (tower_degrees_ + 90.0 * sensor) * degree;
  return is_compass() ? heading_rad_ - tower_rad : heading_rad_ + tower_rad;
}

long RobotBody::read_usual(unsigned sensor) {
  const bool is_missed = random_.chance(missed_echo);
  const long noise_cm = static_cast<long>(random_.below(3)) - 1;
  const long reading_cm = std::lround(world_.distance_to_wall(place_, beam_angle(sensor)));
  if (is_missed || reading_cm + noise_cm > max_range_cm) return 0;
  return reading_cm + noise_cm;
}

long RobotBody::read_thesis(unsigned sensor) {
  const double distance_cm = world_.distance_to_wall(place_, beam_angle(sensor));
  const double scatter = (scatter_cm + scatter_per_cm * distance_cm) * (2 * random_.unit() - 1);
  return std::clamp(static_cast<long>(distance_cm + scatter), 0L, max_reading_cm);
}

void RobotBody::append_obstacle(Bytes& out, unsigned sensor, long reading_cm) const {
  if (reading_cm <= nothing_seen_cm) return;
  const double angle = beam_angle(sensor);
  const double along = static_cast<double>(reading_cm);
  if (is_thesis() && !is_compass()) {  // sin and cos as in the listing, but not of its angles
    append_point(out, place_.x_cm + along * std::sin(angle), place_.y_cm + along * std::cos(angle));
  } else {
    append_point(out, place_.x_cm + along * std::cos(angle), place_.y_cm + along * std::sin(angle));
  }
}

/// The thesis's conversion to int16 truncates towards zero.
void RobotBody::append_point(Bytes& out, double x_cm, double y_cm) const {
  put_i16_le(out, is_thesis() ? static_cast<std::int16_t>(x_cm) : to_cm(x_cm));
  put_i16_le(out, is_thesis() ? static_cast<std::int16_t>(y_cm) : to_cm(y_cm));
}

}  // namespace slamgw::sim
