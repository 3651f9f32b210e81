// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <new>
#include <span>
#include <type_traits>
#include <utility>

namespace svgf {

// Host memory for `size` values that are not initialised: the thread that first writes a page is the one that pays for
// it. std::vector would have one thread write all of it.
template <class T>
class HostBuffer {
    static_assert(std::is_trivially_destructible_v<T>);

public:
    HostBuffer() = default;
    explicit HostBuffer(std::size_t size)
        : data_(size ? static_cast<T*>(::operator new(size * sizeof(T), alignment)) : nullptr), size_(size) {}
    HostBuffer(HostBuffer&& other) noexcept
        : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)) {}
    HostBuffer& operator=(HostBuffer&& other) noexcept {
        std::swap(data_, other.data_);
        std::swap(size_, other.size_);
        return *this;
    }
    ~HostBuffer() {
        if (data_) ::operator delete(data_, alignment);
    }

    T* data() { return data_; }
    const T* data() const { return data_; }
    std::size_t size() const { return size_; }
    bool empty() const { return size_ == 0; }
    T& operator[](std::size_t i) { return data_[i]; }
    const T& operator[](std::size_t i) const { return data_[i]; }
    operator std::span<T>() { return {data_, size_}; }
    operator std::span<const T>() const { return {data_, size_}; }

private:
    static constexpr std::align_val_t alignment{64};

    T* data_ = nullptr;
    std::size_t size_ = 0;
};

}  // namespace svgf
