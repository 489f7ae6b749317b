"""The ring finger's return, predicted from hand and camera: what the experiments of chapter 6 have in common."""
