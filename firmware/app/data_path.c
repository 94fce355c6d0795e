// SPDX-License-Identifier: Apache-2.0
#include "data_path.h"

#include "health.h"
#include "monitor.h"

#include "inertiad_lcm_order_item_t.h"

static void publish_row(daemon_t* d, const ipe_row_t* row, int64_t arrival_ns)
{
    if (d->first_row_ns == 0) { d->first_row_ns = row->t_ns; }
    d->last_row_ns = row->t_ns;
    ipe_rest_detector_push(&d->rest, row);
    const bool is_sent = ipe_publish_row(&d->publisher, row, &d->pipeline->estimator.estimate, health_dropped(d));
    if (is_sent && arrival_ns != 0) { ipe_histogram_push(&d->estimated, ipe_host_clock_now(&d->clock) - arrival_ns); }
}

static void step(daemon_t* d, int64_t arrival_ns)
{
    ipe_row_t row;
    ipe_status_t status;
    while ((status = ipe_pipeline_step(d->pipeline, &row, NULL)) != IPE_NOT_READY) {
        if (status >= IPE_OK) { publish_row(d, &row, arrival_ns); }
    }
}

void data_path_frame(daemon_t* d, const ipe_frame_t* frame, int64_t arrival_ns)
{
    d->data_ns = frame->t_ns;
    ipe_publish_frame(&d->publisher, frame);
    (void)ipe_pipeline_push_frame(d->pipeline, frame);  // a refused frame is counted there
    if (d->pipeline->decode.n_decoded == 0) { ipe_unbound_note(&d->unbound, frame); }
    step(d, arrival_ns);
    monitor_frame(d, frame);
}

void data_path_position(daemon_t* d, int64_t t_ns, const double position[3], int64_t arrival_ns)
{
    ipe_publish_order(&d->publisher, INERTIAD_LCM_ORDER_ITEM_T_POSITION, t_ns, position);
    (void)ipe_pipeline_push_position(d->pipeline, t_ns, position);  // a refused position is counted there
    step(d, arrival_ns);
}

void data_path_flush(daemon_t* d)
{
    ipe_pipeline_flush(d->pipeline);
    step(d, 0);
}
