"""The controllers of the firmware: each turns a set-point and the estimate into thrust and torques."""
