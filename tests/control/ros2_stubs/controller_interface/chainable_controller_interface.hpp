// As much of ros2_control's interface as a generated controller needs, to compile and run it without ROS.
#pragma once

#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#define RCLCPP_ERROR(logger, ...) ((void)(logger), std::fprintf(stderr, __VA_ARGS__))

namespace rclcpp {

struct Time {};

struct Duration {
  double length;
  double seconds() const { return length; }
};

using Value = std::variant<double, std::vector<double>, std::vector<std::string>>;

struct Parameter {
  Value value;
  double as_double() const { return std::get<double>(value); }
  std::vector<double> as_double_array() const { return std::get<std::vector<double>>(value); }
  std::vector<std::string> as_string_array() const { return std::get<std::vector<std::string>>(value); }
};

struct Node {
  std::map<std::string, Value> values;
  const char* get_name() const { return "controller"; }
  int get_logger() const { return 0; }
  Parameter get_parameter(const std::string& name) const { return {values.at(name)}; }
};

}  // namespace rclcpp

namespace rclcpp_lifecycle {
struct State {};
}  // namespace rclcpp_lifecycle

namespace hardware_interface {

class Handle {
 public:
  Handle(std::string prefix, std::string name, double* value)
      : name_(std::move(prefix) + "/" + std::move(name)), value_(value) {}
  const std::string& get_name() const { return name_; }
  [[nodiscard]] std::optional<double> get_optional() const { return *value_; }
  [[nodiscard]] bool set_value(double value) {
    *value_ = value;
    return true;
  }

 private:
  std::string name_;
  double* value_;
};

using CommandInterface = Handle;

}  // namespace hardware_interface

namespace controller_interface {

enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
enum class return_type { OK, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };

struct InterfaceConfiguration {
  interface_configuration_type type;
  std::vector<std::string> names;
};

class ChainableControllerInterface {
 public:
  virtual ~ChainableControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State&) = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State&) = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual return_type update_and_write_commands(const rclcpp::Time&, const rclcpp::Duration&) = 0;
  std::vector<hardware_interface::CommandInterface> export_reference_interfaces() {
    return on_export_reference_interfaces();
  }
  std::shared_ptr<rclcpp::Node> get_node() const { return node_; }

  std::vector<hardware_interface::Handle> command_interfaces_;
  std::vector<hardware_interface::Handle> state_interfaces_;
  std::vector<double> reference_interfaces_;

 protected:
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
  virtual return_type update_reference_from_subscribers(const rclcpp::Time&, const rclcpp::Duration&) = 0;

  template <typename T>
  void auto_declare(const std::string& name, const T& value) {
    node_->values.emplace(name, value);
  }

 private:
  std::shared_ptr<rclcpp::Node> node_ = std::make_shared<rclcpp::Node>();
};

}  // namespace controller_interface
