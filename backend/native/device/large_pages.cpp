// SPDX-License-Identifier: Apache-2.0
#include "device/large_pages.h"

#include <cstdlib>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace svgf {

#if defined(__linux__)
namespace {

constexpr std::size_t alignment = 64;

void* allocate_pages(std::size_t bytes, std::size_t page_size) {
    bytes = (bytes + page_size - 1) / page_size * page_size;
    void* const data = std::aligned_alloc(page_size, bytes);
    if (data) madvise(data, bytes, MADV_HUGEPAGE);  // where it fails, pages are small
    return data;
}

}  // namespace

void* LargePages::allocate(std::size_t bytes) {
    if (bytes > page_size / 2) return allocate_pages(bytes, page_size);
    if (bytes <= page_size >> (most_halvings + 1))
        return std::aligned_alloc(alignment, (bytes + alignment - 1) / alignment * alignment);
    int halvings = 1;
    while (halvings < most_halvings && bytes <= page_size >> (halvings + 1)) ++halvings;

    const std::lock_guard lock(mutex_);
    auto& open = open_[halvings];
    if (open.empty()) {
        void* const data = allocate_pages(page_size, page_size);
        if (!data) return nullptr;
        open.reserve(pages_.size() + 1);  // release may open any of them, and must not fail
        open.push_back(&*pages_.try_emplace(reinterpret_cast<std::uintptr_t>(data), Page{halvings, {}}).first);
    }
    auto& [address, page] = *open.back();
    std::size_t piece = 0;
    while (page.used[piece]) ++piece;
    page.used.set(piece);
    if (page.used.count() == page.pieces()) open.pop_back();
    return reinterpret_cast<void*>(address + piece * page.piece_size());
}

void LargePages::release(void* data) noexcept {
    const auto address = reinterpret_cast<std::uintptr_t>(data);
    const std::lock_guard lock(mutex_);
    const auto found = pages_.find(address / page_size * page_size);
    if (found == pages_.end()) {
        std::free(data);
        return;
    }
    Page& page = found->second;
    auto& open = open_[page.halvings];
    if (page.used.count() == page.pieces()) open.push_back(&*found);
    page.used.reset((address - found->first) / page.piece_size());
    if (page.used.none()) {
        std::erase(open, &*found);
        std::free(reinterpret_cast<void*>(found->first));
        pages_.erase(found);
    }
}
#else
void* LargePages::allocate(std::size_t bytes) {
    return ::operator new(bytes, std::align_val_t{64}, std::nothrow);
}
void LargePages::release(void* data) noexcept { ::operator delete(data, std::align_val_t{64}); }
#endif

}  // namespace svgf
