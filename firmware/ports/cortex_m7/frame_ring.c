// SPDX-License-Identifier: Apache-2.0
#include "frame_ring.h"

bool ipe_frame_ring_put(ipe_frame_ring_t* ring, const ipe_frame_t* frame)
{
    const unsigned head = atomic_load_explicit(&ring->head, memory_order_relaxed);
    if (head - atomic_load_explicit(&ring->tail, memory_order_acquire) == IPE_FRAME_RING) {
        atomic_store_explicit(&ring->n_lost, atomic_load_explicit(&ring->n_lost, memory_order_relaxed) + 1U,
                              memory_order_relaxed);
        return false;
    }
    ring->frame[head % IPE_FRAME_RING] = *frame;
    atomic_store_explicit(&ring->head, head + 1U, memory_order_release);
    return true;
}

const ipe_frame_t* ipe_frame_ring_oldest(ipe_frame_ring_t* ring)
{
    const unsigned tail = atomic_load_explicit(&ring->tail, memory_order_relaxed);
    const unsigned n = atomic_load_explicit(&ring->head, memory_order_acquire) - tail;
    ring->n_most = n > ring->n_most ? n : ring->n_most;
    return n == 0 ? NULL : &ring->frame[tail % IPE_FRAME_RING];
}

void ipe_frame_ring_drop(ipe_frame_ring_t* ring)
{
    atomic_fetch_add_explicit(&ring->tail, 1U, memory_order_release);
}
