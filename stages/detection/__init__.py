"""People in pictures: an estimator's joints, heatmaps and segmentation, guided across the views of a rig."""
