// SPDX-License-Identifier: Apache-2.0
#include "flow.h"

#include "health.h"
#include "monitor.h"

int64_t flow_now(const daemon_t* d)
{
    return d->n_interfaces > 0 ? ipe_host_clock_now(&d->clock) : d->data_ns;
}

/// Tell that the payload changed, when it did.
static void report_change(daemon_t* d, int64_t t_ns)
{
    if (d->pipeline->estimator.change_detector.n_changes == d->n_changes_reported) { return; }
    d->n_changes_reported = d->pipeline->estimator.change_detector.n_changes;
    ipe_publish_event(&d->publisher, t_ns, "detect", "payload changed");
}

static void take_row(daemon_t* d, const ipe_row_t* row)
{
    if (d->first_row_ns == 0) { d->first_row_ns = row->t_ns; }
    d->last_row_ns = row->t_ns;
    d->publisher.n_input_dropped = health_dropped(d);
    ipe_rest_detector_push(&d->rest, row);
    report_change(d, row->t_ns);
    ipe_publish_row(&d->publisher, row);
    const bool is_sent = ipe_publish_estimate(&d->publisher, row->t_ns, &d->pipeline->estimator.estimate);
    if (is_sent && d->arrival_ns != 0) {
        ipe_histogram_push(&d->estimated, ipe_host_clock_now(&d->clock) - d->arrival_ns);
    }
}

void flow_step(daemon_t* d)
{
    ipe_row_t row;
    ipe_status_t status;
    while ((status = ipe_pipeline_step(d->pipeline, &row, NULL)) != IPE_NOT_READY) {
        if (status >= IPE_OK) { take_row(d, &row); }
    }
}

void flow_frame(daemon_t* d, const ipe_frame_t* frame, int64_t arrival_ns)
{
    d->arrival_ns = arrival_ns;
    ipe_publish_frame(&d->publisher, frame);
    if ((frame->can_id & IPE_CAN_ERR) != 0) { monitor_error_frame(d, frame); }
    (void)ipe_pipeline_push_frame(d->pipeline, frame);  // what it refuses, it counts
    flow_step(d);
    d->arrival_ns = 0;
    health_advance(d, frame->t_ns);
    monitor_advance(d, frame->t_ns);
}

void flow_position(daemon_t* d, int64_t t_ns, const double position[3], int64_t arrival_ns)
{
    d->arrival_ns = arrival_ns;
    (void)ipe_pipeline_push_position(d->pipeline, t_ns, position);  // what it refuses, it counts
    flow_step(d);
    d->arrival_ns = 0;
}
