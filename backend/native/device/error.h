// SPDX-License-Identifier: Apache-2.0
// What native code throws; bindings.cpp turns each into the class of the same name in svgf.errors.
#pragma once

#include <stdexcept>
#include <string>

namespace svgf {

struct DeviceError : std::runtime_error {
    DeviceError(std::string stage, const std::string& message, std::string hint = "")
        : std::runtime_error(message), stage(std::move(stage)), hint(std::move(hint)) {}
    std::string stage;  // what ran when it happened; empty outside of a stage
    std::string hint;   // what the user can do about it
};

struct OutOfMemory : DeviceError {
    using DeviceError::DeviceError;
};

struct Interrupted : std::runtime_error {
    explicit Interrupted(const std::string& stage) : std::runtime_error("Stage \"" + stage + "\" was interrupted.") {}
};

struct InputError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

// Throws InputError where input is not as it must be.
inline void expect(bool holds, const char* message) {
    if (!holds) throw InputError(message);
}

}  // namespace svgf
