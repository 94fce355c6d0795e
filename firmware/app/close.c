// SPDX-License-Identifier: Apache-2.0
#include "close.h"

#include "data_path.h"
#include "estimate_file.h"
#include "health.h"
#include "message.h"
#include "monitor.h"
#include "result.h"
#include "unbound.h"

#include <inttypes.h>
#include <string.h>

static int write_estimate(daemon_t* d)
{
    char reason[REASON_SIZE];
    health_count_input(d);
    const ipe_run_t result = {.pipeline = d->pipeline,
                              .counters = &d->counters,
                              .n_frames = health_frames(d),
                              .n_rejected = health_rejected_rows(d),
                              .duration = (double)(d->last_row_ns - d->first_row_ns) / (double)NS_PER_S};
    if (ipe_estimate_file_write(d->option.estimate, &result, reason, sizeof reason) == 0) { return 0; }
    return daemon_refuse("--estimate", reason);
}

/// False if the record of a replay is incomplete; a live record may have lost messages, which are counted.
static bool close_record(daemon_t* d)
{
    if (!d->is_recording) { return true; }
    ipe_publish_record(&d->publisher, NULL);
    const bool is_whole = ipe_record_close(&d->recorder) == 0;
    if (!is_whole) {
        const int cause = atomic_load(&d->recorder.error);
        ipe_message("--record: %s lacks %" PRIu64 " messages: %s", d->recorder.option.path,
                    ipe_record_lost(&d->recorder), cause != 0 ? strerror(cause) : "the queue was full");
    }
    return is_whole || d->n_interfaces > 0;
}

/// False, with the identifiers, if recorded frames came and none carried a signal.
static bool was_bound(const daemon_t* d)
{
    const ipe_decode_t* decode = &d->pipeline->decode;
    const bool has_known = decode->n_decoded > 0 || decode->n_bad_length > 0 || decode->n_out_of_range > 0;
    if (d->n_interfaces > 0 || health_frames(d) == 0 || has_known || d->unbound.n == 0) { return true; }
    char text[REASON_SIZE];
    ipe_unbound_describe(&d->unbound, &d->pipeline->config, text, sizeof text);
    ipe_message("--bus: no frame of the log belongs to a signal of %s; check the order of --bus, [[bus]], [signals]",
                d->option.config);
    ipe_message("--bus: %s", text);
    return false;
}

bool daemon_close(daemon_t* d)
{
    bool is_good = true;
    data_path_flush(d);
    monitor_end(d);
    for (unsigned i = 0; i < d->n_interfaces; ++i) { ipe_source_socketcan_close(&d->interface[i]); }
    ipe_replay_close(&d->replay);
    if (d->option.estimate != NULL && write_estimate(d) != 0) { is_good = false; }
    if (d->option.checkpoint != NULL && ipe_checkpoint_close(&d->checkpoint, d->pipeline) != 0) { is_good = false; }
    ipe_publish_last(&d->publisher, &d->pipeline->estimator.estimate, health_dropped(d));
    health_send(d, daemon_now(d));
    if (!close_record(d)) { is_good = false; }
    health_count(d);
    ipe_publish_close(&d->publisher);
    ipe_inbox_close(&d->inbox);
    ipe_notify_close(&d->notify);
    health_print(d);
    if (!was_bound(d) || (d->replay.is_lock_step && d->replay.lock_step.is_broken)) { is_good = false; }
    result_print(d);
    return is_good;
}
